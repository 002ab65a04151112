"""The vocabulary of facts: what rules may speak of, and how a measured model becomes a fact.

Probes own the templates they measure; this module adds the templates that no probe measures (task, rig, attitude,
plan, trial, operator failures and findings) and rounds every value to its declared resolution, so that a decision does
not depend on the last bits of a measurement.
"""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, ClassVar, Literal, TypeGuard

from modules.probe import FactModel, Probe, quantity

Scalar = float | int | bool | str
Severity = Literal["minor", "major", "critical"]
SEVERITIES: tuple[str, ...] = ("minor", "major", "critical")


class Task(FactModel):
    """What the caller asks for."""

    template: ClassVar[str] = "task"
    profile: Literal["fast", "balanced", "best"] = quantity("Trade of accuracy against time", default="balanced")
    time_budget_s: float | None = quantity("CPU time one pair may take", unit="s", ge=0, default=None)
    memory_budget_mb: float | None = quantity("Memory matching may take", unit="mb", ge=0, default=None)
    machine_speed: float | None = quantity(
        "Speed of this machine over the one that costs were measured on; told with a time budget", ge=0, default=None
    )
    range_given: bool = quantity("Whether the caller gave the disparity range", default=False)


class PredictedCost(FactModel):
    """CPU time that a step is predicted to take on this pair and machine; told where a time budget is stated."""

    template: ClassVar[str] = "cost"
    keys: ClassVar[tuple[str, ...]] = ("step",)
    step: str = quantity("Operator or probe, or `always`: all that every plan takes")
    cpu_s: float = quantity("Predicted CPU time", unit="s", ge=0, resolution=1e-4)


class Rig(FactModel):
    """What is known of the cameras."""

    template: ClassVar[str] = "rig"
    calibrated: bool = quantity("Whether a calibration is given", default=False)
    focal_px: float | None = quantity("Focal length", unit="px", ge=0, resolution=0.01, default=None)
    baseline_m: float | None = quantity("Distance of the cameras", unit="m", ge=0, resolution=1e-5, default=None)
    doffs_px: float | None = quantity("Disparity offset", unit="px", resolution=0.001, default=None)
    rectified_here: bool = quantity("Whether the images were rectified with the calibration on loading", default=False)
    valid_fraction: float | None = quantity(
        "Part of the rectified images that the cameras saw, the smaller of the two",
        ge=0,
        le=1,
        resolution=0.001,
        default=None,
    )
    calibration_scale: float | None = quantity(
        "Factor by which the calibration was scaled to the images", ge=0, resolution=1e-4, default=None
    )


class MeasuredAttitude(FactModel):
    """Attitude of the body from an inertial measurement unit, if there is one."""

    template: ClassVar[str] = "attitude"
    known: bool = quantity("Whether an attitude is given", default=False)
    roll_deg: float | None = quantity("Roll, positive lowers the right side", unit="deg", ge=-180, le=180, default=None)
    pitch_deg: float | None = quantity("Pitch, positive lowers the nose", unit="deg", ge=-90, le=90, default=None)
    sigma_deg: float | None = quantity(
        "Stated standard deviation of roll and pitch; absent where none was stated",
        unit="deg",
        ge=0,
        le=90,
        resolution=0.01,
        default=None,
    )


class StatedRover(FactModel):
    """The rover that shall drive on the terrain, where the caller states one."""

    template: ClassVar[str] = "rover"
    wheel_radius_m: float = quantity("Radius of the wheels", unit="m", ge=0.001, le=2.0, resolution=0.001)
    clearance_m: float = quantity("Height of the belly above the ground", unit="m", ge=0.001, le=5.0, resolution=0.001)
    width_m: float = quantity("Width", unit="m", ge=0.001, le=10.0, resolution=0.001)
    max_tilt_deg: float = quantity("Largest tilt", unit="deg", ge=0.1, le=60.0, resolution=0.1)
    body_front_m: float = quantity(
        "Reach ahead of the body origin", unit="m", ge=0.0, le=20.0, resolution=0.001, default=0.0
    )
    body_back_m: float = quantity("Reach behind it", unit="m", ge=0.0, le=20.0, resolution=0.001, default=0.0)
    min_confidence: float = quantity(
        "Least confidence of points that it drives on", ge=0.0, le=1.0, resolution=0.001, default=0.0
    )
    min_grazing_deg: float = quantity(
        "Flattest angle between ray and ground that it trusts", unit="deg", ge=0.0, le=45.0, resolution=0.1, default=0.0
    )


class Planned(FactModel):
    """An operator that an earlier stage has run."""

    template: ClassVar[str] = "planned"
    keys: ClassVar[tuple[str, ...]] = ("slot",)
    slot: str = quantity("Stage and slot, e.g. correction.radiometry")
    operator: str = quantity("Operator that filled it, or none")


class PreviousPair(FactModel):
    """The pair before this one in a sequence: what was decided about it, and how much has changed since."""

    template: ClassVar[str] = "previous"
    same_rig: bool = quantity("Whether size, calibration and given range are the same")
    change_dn: float = quantity(
        "Mean difference of thumbnails of the left images after equalising their means",
        unit="dn",
        ge=0,
        resolution=0.01,
    )
    level_change_dn: float = quantity(
        "Distance of their distributions of gray levels", unit="dn", ge=0, resolution=0.01
    )
    min_px: int | None = quantity("Smallest disparity that was searched", unit="px", default=None)
    max_px: int | None = quantity("End of the range that was searched, exclusive", unit="px", default=None)
    rows_count: int | None = quantity(
        "Matches that agreed with the fit of the rows, when they were last checked", ge=0, default=None
    )
    rows_aligned: bool = quantity("Whether rows were aligned")
    offset_px: float | None = quantity("Offset that was undone", unit="px", resolution=0.01, default=None)
    roll_deg: float | None = quantity("Roll that was undone", unit="deg", resolution=0.001, default=None)
    row_scale: float | None = quantity("Row scale that was undone", unit="px/px", resolution=0.00001, default=None)
    radiometry: str = quantity("Operator that corrected the radiometry, or none")
    density_fraction: float | None = quantity(
        "Share of the usable pixels that had a disparity", ge=0, le=1, resolution=1e-4, default=None
    )


class Available(FactModel):
    """An optional package that operators may need, and whether it is installed."""

    template: ClassVar[str] = "available"
    keys: ClassVar[tuple[str, ...]] = ("package",)
    package: str = quantity("Import name")
    installed: bool = quantity("Whether it can be imported")


class Trial(FactModel):
    """How many trials of this stage have been made, the present one included."""

    template: ClassVar[str] = "trial"
    number: int = quantity("Number of the trial, from 1", ge=1, le=99)


class Failure(FactModel):
    """An operator that could not do its work."""

    template: ClassVar[str] = "failure"
    keys: ClassVar[tuple[str, ...]] = ("operator",)
    operator: str = quantity("Operator that failed")
    stage: str = quantity("Its stage")


class Finding(FactModel):
    """A symbolic finding that a rule has derived."""

    template: ClassVar[str] = "finding"
    keys: ClassVar[tuple[str, ...]] = ("name", "severity")
    name: str = quantity("Name, declared under `findings` in the rule file")
    severity: Severity = quantity("How much it matters", default="minor")


OWN_TEMPLATES: tuple[type[FactModel], ...] = (
    Task,
    PredictedCost,
    Rig,
    MeasuredAttitude,
    StatedRover,
    Planned,
    PreviousPair,
    Available,
    Trial,
    Failure,
    Finding,
)


def finite(value: Any) -> Scalar | None:
    """Return a value that a field can hold; None for NaN, infinity and what is no scalar.

    Examples
    --------
    >>> finite(2.5), finite(float("nan")), finite(None)
    (2.5, None, None)
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, bool | int | str) else None


def is_number(value: Any) -> TypeGuard[float]:
    """Say whether a value is a number; a boolean is none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _scalar_key(value: Scalar) -> tuple[int, Any, str]:
    if isinstance(value, str):
        return 2, value, "str"
    if value != value:
        return 3, 0.0, "nan"
    return (0, value, "bool") if isinstance(value, bool) else (1, value, type(value).__name__)


@dataclass(frozen=True, order=True)
class Fact:
    """One fact as the engines see it: a template name and its present fields, sorted by name.

    What inference asks of a fact again and again is computed once and kept with it.
    """

    template: str
    fields: tuple[tuple[str, Scalar], ...]

    @classmethod
    def of(cls, template: str, **fields: Scalar | None) -> Fact:
        """Build a fact; None, NaN and infinity mean absent."""
        present = sorted((name, value) for name, value in fields.items() if finite(value) is not None)
        return cls(template, tuple(present))  # type: ignore[arg-type]

    @cached_property
    def values(self) -> Mapping[str, Scalar]:
        """The fields that have a value; NaN and infinity are none."""
        return {name: value for name, value in self.fields if not isinstance(value, float) or math.isfinite(value)}

    @cached_property
    def numbers(self) -> Mapping[str, float]:
        """The fields that hold a finite number; a boolean is none."""
        return {name: value for name, value in self.values.items() if is_number(value)}

    @cached_property
    def key(self) -> tuple[Any, ...]:
        """A key that orders facts totally, values of different kinds included."""
        return self.template, tuple((name, *_scalar_key(value)) for name, value in self.fields)

    @cached_property
    def _hash(self) -> int:
        return hash((self.template, self.fields))

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        return Fact, (self.template, self.fields)  # texts have other hashes in another process

    def get(self, field: str) -> Scalar | None:
        """Return a field's value, or None where it is absent."""
        return self.values.get(field)

    def as_dict(self) -> dict[str, Scalar]:
        """Return the present fields."""
        return dict(self.fields)

    def __str__(self) -> str:
        """Write it as `template(field=value, ...)`."""
        return f"{self.template}({', '.join(f'{name}={value}' for name, value in self.fields)})"


@dataclass(frozen=True)
class FieldInfo:
    """What the vocabulary knows of one field."""

    name: str
    kind: Literal["number", "integer", "boolean", "text"]
    unit: str
    description: str
    ge: float | None = None
    le: float | None = None
    resolution: float | None = None
    sigma: str | None = None
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class TemplateInfo:
    """What the vocabulary knows of one template."""

    name: str
    description: str
    fields: Mapping[str, FieldInfo]
    keys: tuple[str, ...]
    probe: str | None = None
    tier: str | None = None


Vocabulary = Mapping[str, TemplateInfo]


def _kind(annotation: Any) -> tuple[Literal["number", "integer", "boolean", "text"], tuple[str, ...]]:
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        inner = [part for part in typing.get_args(annotation) if part is not type(None)]
        return _kind(inner[0])
    if typing.get_origin(annotation) is Literal:
        return "text", tuple(str(choice) for choice in typing.get_args(annotation))
    if annotation is bool:
        return "boolean", ()
    if annotation is int:
        return "integer", ()
    if annotation is float:
        return "number", ()
    return "text", ()


def _describe_field(model: type[FactModel], name: str) -> FieldInfo:
    info = model.model_fields[name]
    extra = info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
    bounds: dict[str, Any] = {}
    for item in info.metadata:
        for bound in ("ge", "le"):
            if getattr(item, bound, None) is not None:
                bounds[bound] = float(getattr(item, bound))
    kind, choices = _kind(info.annotation)
    resolution = extra.get("resolution")
    sigma = extra.get("sigma")
    return FieldInfo(
        name=name,
        kind=kind,
        unit=str(extra.get("unit", "1")),
        description=info.description or "",
        resolution=None if resolution is None else float(typing.cast(float, resolution)),
        sigma=None if sigma is None else str(sigma),
        choices=choices,
        **bounds,
    )


@cache
def _describe(model: type[FactModel], probe: Probe | None) -> TemplateInfo:
    return TemplateInfo(
        name=model.template,
        description=(model.__doc__ or "").strip().splitlines()[0],
        fields={name: _describe_field(model, name) for name in model.model_fields},
        keys=model.keys,
        probe=probe.name if probe else None,
        tier=probe.tier if probe else None,
    )


def vocabulary(probes: Iterable[Probe]) -> Vocabulary:
    """Return every template that rules may speak of, by name."""
    known = {model.template: _describe(model, None) for model in OWN_TEMPLATES}
    for probe in probes:
        for model in probe.templates:
            known[model.template] = _describe(model, probe)
    return known


@cache
def _resolutions(model: type[FactModel]) -> tuple[tuple[str, float | None], ...]:
    return tuple((name, _describe_field(model, name).resolution) for name in model.model_fields)


def to_fact(model: FactModel) -> Fact:
    """Turn a measured model into a fact, each value rounded to its resolution."""
    fields: dict[str, Scalar | None] = {}
    for name, resolution in _resolutions(type(model)):
        value = getattr(model, name)
        if isinstance(value, float):
            step = resolution or 1e-6
            value = round(round(value / step) * step, 9) + 0.0
        fields[name] = value
    return Fact.of(model.template, **fields)
