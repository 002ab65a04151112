"""What an operator is: a parameter model, a pure function and one catalog entry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict


class OperatorParams(BaseModel):
    """Base of all parameter models: frozen, closed; every field has a default, a range and a description."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True)
class Cost:
    """Linear cost model of an operator on the reference machine (one core of about 3 GHz).

    A decision under a time budget uses this model, never the clock, so that it is reproducible.
    """

    fixed_ms: float = 0.0
    ns_per_pixel: float = 0.0
    ns_per_pixel_disparity: float = 0.0

    def seconds(self, pixels: int, disparities: int = 0) -> float:
        """Predict the CPU time in seconds for an image of `pixels` and a range of `disparities`."""
        per_pixel = self.ns_per_pixel + self.ns_per_pixel_disparity * disparities
        return self.fixed_ms * 1e-3 + pixels * per_pixel * 1e-9


@dataclass(frozen=True)
class Operator:
    """One entry of the catalog.

    Attributes
    ----------
    name : str
        `<stage>.<verb_phrase>`, e.g. `correction.match_histograms`.
    slot : str
        Slot of the stage that it can fill.
    params : type[OperatorParams]
        Its parameter model.
    function : callable
        Pure function `(state, params) -> state`; the state is `Views` in correction, `Matching` in matching and `Scene`
        in reconstruction.
    cost : Cost
        CPU time model.
    summary : str
        One sentence for reports: what it does.
    suits : str
        One sentence: when it helps and when it harms.
    needs : tuple of str
        What must be there: importable packages (`numba`), or `calibration`, `attitude`.
    """

    name: str
    slot: str
    params: type[OperatorParams]
    function: Callable[[Any, Any], Any]
    cost: Cost
    summary: str
    suits: str = ""
    needs: tuple[str, ...] = ()

    @property
    def stage(self) -> str:
        """The stage, first part of the name."""
        return self.name.split(".", 1)[0]


class OperatorError(Exception):
    """An operator could not do its work on this input; the loop turns it into a finding."""
