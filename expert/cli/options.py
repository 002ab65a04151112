"""Options that mean the same in every command: what is known of a pair, and which system works on it.

A group of options is a dataclass; `expanded` gives a command the options of the groups that it takes.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, get_type_hints

import typer

from expert.cli.usage import UsageError

if TYPE_CHECKING:
    from expert.api import ExpertSystem
    from expert.decision import Decision
    from expert.pair import StereoPair
    from modules.types import Attitude, Rover

Left = Annotated[Path, typer.Argument(help="Left image")]
Right = Annotated[Path, typer.Argument(help="Right image")]
CalibrationOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--calibration",
        help="terrex YAML, OpenCV, ROS, Kalibr, EuRoC, KITTI or Middlebury; raw images are rectified. Give it twice "
        "for the two files of OpenCV (intrinsics, extrinsics), ROS or EuRoC (left, right)",
    ),
]
RectifiedOption = Annotated[
    bool, typer.Option("--rectified", help="The images are rectified already, though the calibration is of raw ones")
]
AlphaOption = Annotated[
    float | None, typer.Option("--alpha", help="Rectification: 0 keeps only valid pixels, 1 all the cameras saw")
]
ScaleOption = Annotated[
    bool, typer.Option("--scale-calibration", help="Scale a calibration of another size of the same images")
]
AttitudeOption = Annotated[
    Path | None,
    typer.Option("--attitude", help="YAML: roll_deg, ..., quaternion, rotation_matrix or accelerometer_mps2"),
]
Degrees = Annotated[float | None, typer.Option(help="degrees, REP 103: positive pitch lowers the nose")]
ImuOption = Annotated[
    Path | None, typer.Option("--imu", help="CSV log of the inertial unit; needs the time of each pair")
]
TimeOption = Annotated[float | None, typer.Option("--time", help="Time of the pair on the clock of --imu, s")]
MaxGapOption = Annotated[
    float,
    typer.Option("--max-gap", min=0.0, help="Longest gap in --imu that is interpolated, s; longer ones are refused"),
]
Convention: TypeAlias = Literal["rep103", "aerospace", "euroc"]
ConventionOption = Annotated[
    Convention,
    typer.Option(
        "--convention",
        help="Axes of --imu (euroc: x up, y right, z forward) and --roll --pitch --yaw (aerospace: nose up, heading)",
    ),
]
RangeOption = Annotated[
    tuple[int, int] | None, typer.Option("--disparity-range", metavar="MIN MAX", help="px; estimated if not given")
]
RulesOption = Annotated[list[Path] | None, typer.Option("--rules", help="Rule file layered on the shipped rules")]
TimeBudgetOption = Annotated[
    float | None,
    typer.Option(
        "--time-budget",
        metavar="S",
        min=0.0,
        help="CPU time a pair may take; costs are predicted, findings say what was given up",
    ),
]
MemoryBudgetOption = Annotated[
    float | None, typer.Option("--memory-budget", metavar="MB", min=0.0, help="Memory matching may take")
]
PreviousOption = Annotated[
    Path | None,
    typer.Option("--previous", help="decision.json of the pair before in a sequence; what holds on is taken over"),
]
Profile: TypeAlias = Literal["fast", "balanced", "best"]
EngineName: TypeAlias = Literal["experta", "compiled"]


@dataclass(frozen=True)
class CameraOptions:
    """What the command line says of the cameras."""

    calibration: CalibrationOption = None
    rectified: RectifiedOption = False
    alpha: AlphaOption = None
    scale_calibration: ScaleOption = False

    def load(
        self,
        left: Path,
        right: Path,
        attitude: Attitude | None = None,
        range_px: tuple[int, int] | None = None,
        convention: Convention = "rep103",
    ) -> StereoPair:
        """Read a pair of these cameras.

        Raises
        ------
        UsageError
            Something is said of a calibration that is not given.
        """
        from expert.pair import StereoPair

        if not self.calibration and (self.rectified or self.alpha is not None or self.scale_calibration):
            raise UsageError("--rectified, --alpha and --scale-calibration say how to use --calibration; give it")
        return StereoPair.load(
            left,
            right,
            calibration=self.calibration or None,
            attitude=attitude,
            disparity_range_px=range_px,
            rectified=self.rectified,
            alpha=self.alpha,
            scale_calibration=self.scale_calibration,
            convention=convention,
        )


@dataclass(frozen=True)
class AttitudeOptions:
    """What the command line says of the attitude; at most one way may be used."""

    attitude: AttitudeOption = None
    roll: Degrees = None
    pitch: Degrees = None
    yaw: Degrees = None
    imu: ImuOption = None
    convention: ConventionOption = "rep103"
    max_gap: MaxGapOption = 0.5

    def read(self, time_s: float | None) -> Attitude | None:
        """Return the attitude of a pair taken at a time, or None where none was given.

        Raises
        ------
        UsageError
            Two ways at once, half of one, or a convention of what states its own.
        """
        from modules.formats import attitude_from_degrees, read_attitude, read_imu_log

        angles = self.angles_deg()
        if (self.imu is None) != (time_s is None):
            raise UsageError("--imu LOG and --time T belong together; give both or neither")
        if self.imu is not None and time_s is not None:
            return read_imu_log(self.imu, self.convention).at(time_s, max_gap_s=self.max_gap)
        if self.attitude is not None:
            if self.convention != "rep103":
                raise UsageError(
                    f"--convention is that of --imu and of --roll --pitch --yaw; write `convention: {self.convention}` "
                    f"into {self.attitude} instead"
                )
            return read_attitude(self.attitude)
        return None if angles is None else attitude_from_degrees(*angles, convention=self.convention)

    def body(self) -> Convention:
        """Return the axes of the body in which the attitude was stated."""
        from modules.formats.attitude import convention_of

        return self.convention if self.attitude is None else convention_of(self.attitude)

    def angles_deg(self) -> tuple[float, float, float | None] | None:
        """Return roll, pitch and yaw, or None where none was given.

        Raises
        ------
        UsageError
            The attitude is stated in two ways.
        """
        by_angles = any(angle is not None for angle in (self.roll, self.pitch, self.yaw))
        if self.attitude is not None and by_angles:
            raise UsageError("give --attitude FILE or --roll --pitch --yaw, not both")
        if self.imu is not None and (self.attitude is not None or by_angles):
            raise UsageError("give --imu LOG --time T, --attitude FILE or --roll --pitch --yaw: one of them")
        return (self.roll or 0.0, self.pitch or 0.0, self.yaw) if by_angles else None


@dataclass(frozen=True)
class PairOptions:
    """A pair, and what the command line says of it."""

    left: Left
    right: Right
    cameras: CameraOptions
    stated: AttitudeOptions
    time: TimeOption = None
    disparity_range: RangeOption = None

    def load(self) -> StereoPair:
        """Read the pair."""
        return self.cameras.load(
            self.left, self.right, self.stated.read(self.time), self.disparity_range, self.stated.body()
        )


@dataclass(frozen=True)
class BudgetOptions:
    """What one pair may take."""

    time_budget: TimeBudgetOption = None
    memory_budget: MemoryBudgetOption = None


@dataclass(frozen=True)
class SystemOptions:
    """Which expert system works on pairs."""

    rules: RulesOption = None
    profile: Profile = "balanced"
    engine: EngineName = "experta"

    def system(self, rover: Rover | None = None, budgets: BudgetOptions | None = None) -> ExpertSystem:
        """Return the system."""
        from expert.api import ExpertSystem

        return ExpertSystem(
            rules=self.rules or [],
            profile=self.profile,
            engine=self.engine,
            time_budget_s=budgets.time_budget if budgets else None,
            memory_budget_mb=budgets.memory_budget if budgets else None,
            rover=rover,
        )


def read_previous(path: Path | None) -> Decision | None:
    """Read the decision about the pair before, where one is named.

    Raises
    ------
    UsageError
        The file cannot be read or is no decision record.
    """
    from expert.decision import Decision

    if path is None:
        return None
    try:
        return Decision.from_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"--previous {path} is no decision.json of a run: {error}") from error


def expanded(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of the groups that its parameters name, and pass it the groups.

    Parameters
    ----------
    command : callable
        Its parameters are options for typer, or groups: dataclasses of options, or of groups.
    """
    hints = get_type_hints(command, include_extras=True)
    own = inspect.signature(command).parameters
    groups = {name: hints[name] for name in own if is_dataclass(hints[name])}
    found: dict[str, inspect.Parameter] = {}
    for name, parameter in own.items():
        options = _options(groups[name]) if name in groups else [parameter.replace(annotation=hints[name])]
        found.update({option.name: option.replace(kind=inspect.Parameter.KEYWORD_ONLY) for option in options})

    @functools.wraps(command)
    def with_options(**values: Any) -> None:
        made = {name: _made(group, values) for name, group in groups.items()}
        command(**made, **{name: values[name] for name in own if name not in groups})

    with_options.__annotations__ = {name: parameter.annotation for name, parameter in found.items()}
    with_options.__signature__ = inspect.Signature(list(found.values()))  # type: ignore[attr-defined]
    return with_options


def _options(group: type) -> Iterator[inspect.Parameter]:
    """Yield the options of a group, those of groups in it included."""
    hints = get_type_hints(group, include_extras=True)
    defaults = inspect.signature(group).parameters
    for field in fields(group):
        if is_dataclass(hints[field.name]):
            yield from _options(hints[field.name])
        else:
            yield defaults[field.name].replace(annotation=hints[field.name])


def _made(group: type, values: Mapping[str, Any]) -> Any:
    """Return a group with the values of its options."""
    hints: dict[str, Any] = get_type_hints(group, include_extras=True)
    made = {
        field.name: _made(hints[field.name], values) if is_dataclass(hints[field.name]) else values[field.name]
        for field in fields(group)
    }
    return group(**made)
