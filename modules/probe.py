"""What a probe is: fact models, a pure function that measures them, and one catalog entry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from modules.operator import Cost

Tier = Literal["cheap", "medium", "dear"]
Subject = Literal["pair", "disparity", "terrain"]


class FactModel(BaseModel):
    """Base of all fact templates: frozen, closed; NaN is not a value, absence is None.

    `template` names the template. `keys` are the fields that tell the instances of a template apart (for example
    `side`, `channel`); a template without keys has at most one instance per pair.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    template: ClassVar[str]
    keys: ClassVar[tuple[str, ...]] = ()


def quantity(
    description: str,
    *,
    unit: str = "1",
    ge: float | None = None,
    le: float | None = None,
    resolution: float | None = None,
    sigma: str | None = None,
    default: Any = ...,
) -> Any:
    """Declare a field of a fact template.

    Parameters
    ----------
    description : str
        What it is, one sentence fragment.
    unit : str
        `1` for dimensionless, else `dn`, `px`, `m`, `deg`, `s`, `mb`, `dn/px`, ...
    ge, le : float, optional
        Range of possible values, inclusive.
    resolution : float, optional
        Values are rounded to a multiple of this before any rule sees them, so that decisions are reproducible.
    sigma : str, optional
        Name of the field that holds the standard uncertainty of this one; enables `significantly_gt` and `..._lt`.
    default : any
        Default value; None makes the field optional.
    """
    extra: dict[str, Any] = {"unit": unit, "resolution": resolution, "sigma": sigma}
    return Field(default, description=description, ge=ge, le=le, json_schema_extra=extra)


@dataclass(frozen=True)
class Probe:
    """One entry of the catalog of probes.

    Attributes
    ----------
    name : str
        `<module>.<what>`, e.g. `measurement.brightness`.
    templates : tuple of FactModel types
        Templates it measures.
    function : callable
        Pure function from the subject to fact models: a `Sample` for pairs, a `Matching` for disparities, a `Scene`
        for terrain.
    tier : {"cheap", "medium", "dear"}
        Cheap probes run unless a rule leaves them out (`exclude:`), the others when a rule asks (`measure:`).
    cost : Cost
        CPU time model; without disparities.
    """

    name: str
    templates: tuple[type[FactModel], ...]
    function: Callable[[Any], Sequence[FactModel]]
    tier: Tier
    subject: Subject
    summary: str
    cost: Cost = field(default_factory=Cost)
