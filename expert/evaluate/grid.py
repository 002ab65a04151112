"""The fixed configurations of `grid.yaml`: the same steps for every pair, whatever it is like."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

import yaml
from pydantic import BaseModel, ConfigDict, Field

from expert.evaluate.systems import Outcome, digest_of
from expert.facts import Scalar
from modules.catalog import operators
from modules.correction.align_rows import AlignRowsParams, align_rows
from modules.measurement.sample import Sample
from modules.operator import OperatorError
from modules.types import DisparityRange, Matching, Views


class FixedStep(BaseModel):
    """An operator with the parameters that differ from its defaults."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    operator: str
    with_: dict[str, Scalar] = Field(default_factory=dict, alias="with")


class _Grid(BaseModel):
    """The file as it is written."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    checks: list[str]
    matchers: dict[str, FixedStep]
    corrections: dict[str, list[FixedStep]]
    configurations: list[list[str]]


@dataclass(frozen=True)
class FixedSystem:
    """One fixed configuration.

    Attributes
    ----------
    name : str
        `[align+][correction+]matcher`.
    align : bool
        Whether the rows are fitted on feature matches and realigned where the fit succeeds.
    steps : tuple of FixedStep
        Corrections, matcher, checks.
    """

    name: str
    align: bool
    steps: tuple[FixedStep, ...]
    kind: str = "fixed"

    def digest(self) -> str:
        """Identify what would be run."""
        steps = [(step.operator, sorted(step.with_.items())) for step in self.steps]
        return digest_of(self.align, steps)

    def __hash__(self) -> int:
        """Hash what would be run."""
        return hash(self.digest())

    def run(self, views: Views, ndisp: int) -> Outcome:
        """Run the steps; an operator that fails leaves no disparity."""
        try:
            return Outcome(self._disparity(views, ndisp))
        except OperatorError as error:
            return Outcome(None, failure=str(error))

    def _disparity(self, views: Views, ndisp: int) -> Matching:
        catalog = operators()
        state = Matching(_aligned(views) if self.align else views, DisparityRange(0, ndisp))
        for step in self.steps:
            operator = catalog[step.operator]
            params = operator.params(**step.with_)
            if operator.stage == "correction":
                state = Matching(operator.function(state.views, params), state.range_px)
            else:
                state = operator.function(state, params)
        return state


def _aligned(views: Views) -> Views:
    """Realign the rows as a fixed pipeline does: always, where enough matches agree at all."""
    fit = Sample(views).features.fit
    if fit is None:
        return views
    model = fit.model
    params = AlignRowsParams(
        offset_px=max(-200.0, min(200.0, model.offset_px)),
        roll_deg=max(-10.0, min(10.0, math.degrees(model.roll_rad))),
        row_scale=max(-0.2, min(0.2, model.scale)),
    )
    return align_rows(views, params)


def fixed_grid() -> Mapping[str, FixedSystem]:
    """Return the fixed configurations by name, in the order of the file."""
    text = resources.files("expert.evaluate").joinpath("grid.yaml").read_text(encoding="utf-8")
    grid = _Grid.model_validate(yaml.safe_load(text))
    found: dict[str, FixedSystem] = {}
    for matcher, correction, *rest in grid.configurations:
        align = "align" in rest
        parts = [*(["align"] if align else []), *([correction] if correction != "none" else []), matcher]
        checks = [FixedStep(operator=name) for name in grid.checks]
        steps = (*grid.corrections[correction], grid.matchers[matcher], *checks)
        system = FixedSystem("+".join(parts), align, steps)
        found[system.name] = system
    return found
