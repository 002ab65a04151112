"""The vocabulary of facts: what rules may speak of, and how a measured model becomes a fact.

Probes own the templates they measure; this module adds the templates that no probe measures (task, rig, attitude,
plan, trial, operator failures and findings) and rounds every value to its declared resolution, so that a decision does
not depend on the last bits of a measurement.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Literal

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
    range_given: bool = quantity("Whether the caller gave the disparity range", default=False)


class Rig(FactModel):
    """What is known of the cameras."""

    template: ClassVar[str] = "rig"
    calibrated: bool = quantity("Whether a calibration is given", default=False)
    focal_px: float | None = quantity("Focal length", unit="px", ge=0, resolution=0.01, default=None)
    baseline_m: float | None = quantity("Distance of the cameras", unit="m", ge=0, resolution=1e-5, default=None)
    doffs_px: float | None = quantity("Disparity offset", unit="px", resolution=0.001, default=None)


class MeasuredAttitude(FactModel):
    """Attitude of the body from an inertial measurement unit, if there is one."""

    template: ClassVar[str] = "attitude"
    known: bool = quantity("Whether an attitude is given", default=False)
    roll_deg: float | None = quantity("Roll, positive lowers the right side", unit="deg", ge=-180, le=180, default=None)
    pitch_deg: float | None = quantity("Pitch, positive lowers the nose", unit="deg", ge=-90, le=90, default=None)


class Planned(FactModel):
    """An operator that an earlier stage has run."""

    template: ClassVar[str] = "planned"
    keys: ClassVar[tuple[str, ...]] = ("slot",)
    slot: str = quantity("Stage and slot, e.g. correction.radiometry")
    operator: str = quantity("Operator that filled it, or none")


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
    Rig,
    MeasuredAttitude,
    Planned,
    Available,
    Trial,
    Failure,
    Finding,
)


@dataclass(frozen=True, order=True)
class Fact:
    """One fact as the engines see it: a template name and its present fields, sorted by name."""

    template: str
    fields: tuple[tuple[str, Scalar], ...]

    @classmethod
    def of(cls, template: str, **fields: Scalar | None) -> Fact:
        """Build a fact; None means absent."""
        present = sorted((name, value) for name, value in fields.items() if value is not None)
        return cls(template, tuple(present))

    def get(self, field: str) -> Scalar | None:
        """Return a field's value, or None where it is absent."""
        for name, value in self.fields:
            if name == field:
                return value
        return None

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
