"""The options that say what is known of a pair: calibration, attitude, range. They mean the same in every command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import typer

from expert.cli.usage import UsageError

if TYPE_CHECKING:
    from expert.pair import StereoPair
    from modules.types import Attitude

Left = Annotated[Path, typer.Argument(help="Left image")]
Right = Annotated[Path, typer.Argument(help="Right image")]
CalibrationOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--calibration",
        help="terrex YAML, OpenCV, ROS, Kalibr, KITTI or Middlebury; raw images are rectified. Give it twice for the "
        "two files of OpenCV (intrinsics, extrinsics) or ROS (left, right)",
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
ImuOption = Annotated[Path | None, typer.Option("--imu", help="CSV log of the inertial unit; needs --time")]
TimeOption = Annotated[float | None, typer.Option("--time", help="Time of the pair on the clock of --imu, s")]
Convention: TypeAlias = Literal["rep103", "aerospace"]
ConventionOption = Annotated[
    Convention, typer.Option("--convention", help="Of --roll --pitch --yaw and --imu; aerospace: nose up, heading")
]
RangeOption = Annotated[
    tuple[int, int] | None, typer.Option("--disparity-range", metavar="MIN MAX", help="px; estimated if not given")
]
Angles: TypeAlias = tuple[float | None, float | None, float | None]


@dataclass(frozen=True)
class StatedAttitude:
    """What the command line says of the attitude; at most one way may be used."""

    file: Path | None = None
    angles: Angles = (None, None, None)
    imu: Path | None = None
    time_s: float | None = None
    convention: Convention = "rep103"

    def read(self) -> Attitude | None:
        """Return the attitude, or None where none was given.

        Raises
        ------
        UsageError
            Two ways at once, or half of one.
        """
        from modules.formats import attitude_from_degrees, read_attitude, read_imu_log

        by_angles = any(angle is not None for angle in self.angles)
        if self.file is not None and by_angles:
            raise UsageError("give --attitude FILE or --roll --pitch --yaw, not both")
        if self.imu is not None and (self.file is not None or by_angles):
            raise UsageError("give --imu LOG --time T, --attitude FILE or --roll --pitch --yaw: one of them")
        if (self.imu is None) != (self.time_s is None):
            raise UsageError("--imu LOG and --time T belong together; give both or neither")
        if self.imu is not None and self.time_s is not None:
            return read_imu_log(self.imu, self.convention).at(self.time_s)
        if self.file is not None:
            return read_attitude(self.file)
        if by_angles:
            roll, pitch, yaw = self.angles
            return attitude_from_degrees(roll or 0.0, pitch or 0.0, yaw, convention=self.convention)
        return None


@dataclass(frozen=True)
class StatedCalibration:
    """What the command line says of the cameras."""

    files: list[Path] | None = None
    rectified: bool = False
    alpha: float | None = None
    scale: bool = False


def load_pair(
    left: Path,
    right: Path,
    calibration: StatedCalibration,
    attitude: StatedAttitude,
    disparity_range: tuple[int, int] | None,
) -> StereoPair:
    """Read the pair that the options describe."""
    from expert.pair import StereoPair

    if not calibration.files and (calibration.rectified or calibration.alpha is not None or calibration.scale):
        raise UsageError("--rectified, --alpha and --scale-calibration say how to use --calibration; give it")
    return StereoPair.load(
        left,
        right,
        calibration=calibration.files or None,
        attitude=attitude.read(),
        disparity_range_px=disparity_range,
        rectified=calibration.rectified,
        alpha=calibration.alpha,
        scale_calibration=calibration.scale,
    )
