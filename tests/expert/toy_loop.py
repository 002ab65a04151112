"""Tiny operators, probes and rules whose every step is known, for tests of the loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from pydantic import Field
from synthetic_pairs import shifted

from expert.engine import make_engine
from expert.facts import Task, to_fact, vocabulary
from expert.knowledge import Knowledge
from expert.plan import Directives
from expert.rules.load import LoadedRules
from expert.rules.model import RuleBase
from expert.supervise import Run
from modules.measurement.sample import Sample
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.probe import FactModel, Probe, quantity
from modules.types import Views


class Quality(FactModel):
    """How good the product of a test is."""

    template: ClassVar[str] = "quality"
    score: float = quantity("No-reference score", ge=0, le=1, resolution=0.01)


class Depth(FactModel):
    """What a dear probe of the pair measures."""

    template: ClassVar[str] = "depth"
    value: float = quantity("Value", ge=0, le=10)


class Gloss(FactModel):
    """What a dear probe of the product measures."""

    template: ClassVar[str] = "gloss"
    value: float = quantity("Value", ge=0, le=10)


class Bright(FactModel):
    """What a cheap probe of the pair measures."""

    template: ClassVar[str] = "bright"
    value: float = quantity("Value", ge=0, le=255)


class Params(OperatorParams):
    level: int = Field(1, ge=0, le=9, description="Level")


@dataclass
class World:
    """Operators that log what they do; their product is the text of all that was done, scored by `scores`."""

    scores: dict[str, float] = field(default_factory=dict)
    broken: set[str] = field(default_factory=set)  # operators, or one with its level
    log: list[str] = field(default_factory=list)
    depth_fails: bool = False
    unscored: bool = False

    def operator(self, name: str, slot: str) -> Operator:
        def work(state: str, params: Params) -> str:
            self.log.append(f"{name} {params.level}")
            if name in self.broken or self.log[-1] in self.broken:
                raise OperatorError("it is broken")
            return f"{state}>{name.split('.')[1]}{params.level}"

        cost = Cost(fixed_ms=1e3) if name == "matching.fine" else Cost()
        return Operator(name, slot, Params, work, cost, "Logs")

    def operators(self) -> dict[str, Operator]:
        made = [self.operator(f"correction.{name}", "radiometry") for name in ("mild", "strong")]
        made += [self.operator(f"matching.{name}", "matcher") for name in ("plain", "fine", "coarse")]
        return {operator.name: operator for operator in made}

    def probes(self) -> dict[str, Probe]:
        def depth(sample: Sample) -> list[FactModel]:
            self.log.append("probe depth")
            if self.depth_fails:
                raise OperatorError("it is too dark")
            return [Depth(value=5.0)]

        def quality(product: str) -> list[FactModel]:
            return [] if self.unscored else [Quality(score=self.scores.get(product, 0.1))]

        probes = [
            Probe("measurement.bright", (Bright,), lambda _: [Bright(value=100.0)], "cheap", "pair", "Cheap"),
            Probe("measurement.depth", (Depth,), depth, "dear", "pair", "Dear"),
            Probe("measurement.quality", (Quality,), quality, "cheap", "disparity", "Product"),
            Probe("measurement.gloss", (Gloss,), lambda _: [Gloss(value=5.0)], "medium", "disparity", "Dear product"),
        ]
        return {probe.name: probe for probe in probes}

    def run(self, *rules: dict[str, Any]) -> Run:
        slots = {
            "correction": [{"slot": "radiometry", "default": "none", "because": "a test"}],
            "matching": [{"slot": "matcher", "default": "matching.plain", "because": "a test"}],
        }
        declared = {"seen": "something was seen", "poor": "the product is poor"}
        numbered = [
            {"id": f"TST{n:03d}", "name": "test", "because": "because of a test", "references": ["test"], **rule}
            for n, rule in enumerate(rules, start=1)
        ]
        base = RuleBase.model_validate({"slots": slots, "findings": declared, "rules": numbered})
        probes = self.probes()
        loaded = LoadedRules(base, {}, "digest", None)  # type: ignore[arg-type]
        engine = make_engine("compiled", vocabulary(probes.values()))
        knowledge = Knowledge(loaded, engine, self.operators(), probes)
        return Run(knowledge, Sample(Views(*shifted())), {to_fact(Task()): None})


def matched(run: Run) -> Any:
    """Run measurement, correction and matching; the correction is run again where the directives change it."""

    def start(directives: Directives) -> str:
        return run.execute(run.plan("correction", directives), "pair")

    run.decide_measurement()
    return run.run_stage("matching", "disparity", start)


ALWAYS = {"fact": "task"}
FIRST = {"fact": "trial", "field": "number", "op": "eq", "value": 1}
POOR = {"fact": "quality", "field": "score", "op": "lt", "value": 0.5}
