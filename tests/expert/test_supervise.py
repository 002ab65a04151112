"""The loop, with tiny operators and probes whose every step is known."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import pytest
from pydantic import Field
from synthetic_pairs import shifted

from expert.costs import Costs
from expert.engine import make_engine
from expert.facts import Task, to_fact, vocabulary
from expert.knowledge import Knowledge
from expert.plan import Candidate, Directives
from expert.rules.load import LoadedRules
from expert.rules.model import RuleBase
from expert.supervise import MAX_TRIALS, Run
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


def test_a_good_first_trial_is_accepted() -> None:
    world = World(scores={"pair>plain1": 0.9})
    run = world.run()
    assert matched(run) == "pair>plain1"
    assert [(trial.number, trial.score, trial.kept, trial.answer) for trial in run.trials] == [
        (1, 0.9, True, "accepted")
    ]


@pytest.mark.parametrize(("budget_s", "tried"), [(0.9, ["plain 1"]), (1.1, ["plain 1", "fine 1"])])
def test_a_trial_that_does_not_fit_the_budget_is_given_up_and_said(budget_s: float, tried: list[str]) -> None:
    world = World(scores={"pair>plain1": 0.2, "pair>fine1": 0.9})
    run = world.run({"stage": "matching", "when": [POOR], "then": [{"repair": "matching.fine"}]})
    run.facts = {to_fact(Task(time_budget_s=budget_s)): None}
    known = run.knowledge
    run.costs = Costs(known.rules.base, known.operators, known.probes, pixels=100, columns=10, calibrated=False)
    matched(run)
    assert world.log == [f"matching.{name}" for name in tried]
    sentences = [finding.sentence for finding in run.findings()]
    given_up = (
        "another trial of the matching was given up: it is predicted to take 1.00 s, and about 0.89 s of the time "
        "budget of 0.9 s are left"
    )
    assert sentences == ([given_up] if len(tried) == 1 else [])


@pytest.mark.parametrize(("budget_s", "again"), [(1.5, False), (2.5, True)])
def test_what_a_trial_would_run_again_counts_before_it_runs(budget_s: float, again: bool) -> None:
    world = World()
    run = world.run(
        {"stage": "matching", "when": [ALWAYS], "then": [{"choose": "matching.fine", "score": 0.5}]},
        {"stage": "matching", "when": [POOR, FIRST], "then": [{"repair": "correction.mild"}]},
        {"stage": "correction", "when": [ALWAYS], "then": [{"choose": "correction.strong", "score": 0.5}]},
    )
    run.facts = {to_fact(Task(time_budget_s=budget_s)): None}
    known = run.knowledge
    run.costs = Costs(known.rules.base, known.operators, known.probes, pixels=100, columns=10, calibrated=False)
    matched(run)
    assert world.log == ["correction.strong 1", "matching.fine 1", *(["correction.mild 1", "matching.fine 1"] * again)]
    assert bool(run.given_up) is not again


def test_a_cheap_probe_always_runs_and_a_dear_one_only_on_demand() -> None:
    world = World()
    run = world.run()
    run.decide_measurement()
    assert run.measured == {"measurement.bright"}
    assert world.log == []
    asking = World()
    run = asking.run(
        {"stage": "measurement", "when": [{"fact": "bright", "field": "value", "op": "gt", "value": 50.0}],
         "then": [{"measure": "measurement.depth"}]},
        {"stage": "measurement", "when": [{"fact": "depth", "field": "value", "op": "gt", "value": 1.0}],
         "then": [{"derive": "seen"}]},
    )  # fmt: skip
    run.decide_measurement()
    assert asking.log == ["probe depth"]  # once, though its rule fires in every round
    assert [finding.name for finding in run.findings()] == ["seen"]
    assert run.facts[to_fact(Depth(value=5.0))] == "measurement.depth"


def test_a_rule_leaves_a_cheap_probe_out_for_what_the_caller_stated() -> None:
    forgo = {"stage": "measurement", "then": [{"exclude": "measurement.bright"}]}
    run = World().run({**forgo, "when": [{"fact": "task", "field": "profile", "op": "eq", "value": "balanced"}]})
    run.decide_measurement()
    assert run.measured == set()
    run = World().run({**forgo, "when": [{"fact": "task", "field": "profile", "op": "eq", "value": "fast"}]})
    run.decide_measurement()
    assert run.measured == {"measurement.bright"}


def test_what_is_left_out_is_measured_if_a_rule_asks_for_it() -> None:
    run = World().run(
        {"stage": "measurement", "when": [ALWAYS], "then": [{"exclude": "measurement.bright"}]},
        {"stage": "measurement", "when": [ALWAYS], "then": [{"measure": "measurement.bright"}]},
    )
    run.decide_measurement()
    assert run.measured == {"measurement.bright"}


def test_a_dear_probe_of_the_product_runs_when_a_rule_asks() -> None:
    def look(asking: bool) -> tuple[set[str], list[str]]:
        world = World(scores={"pair>plain1": 0.9})
        seen = {"fact": "gloss", "field": "value", "op": "gt", "value": 1.0}
        asked = [{"stage": "matching", "when": [ALWAYS], "then": [{"measure": "measurement.gloss"}]}] if asking else []
        run = world.run(*asked, {"stage": "matching", "when": [seen], "then": [{"assess": "seen"}]})
        matched(run)
        facts = {fact.template for fact in run.product_facts["matching"]}
        return facts, [finding.name for finding in run.findings()]

    assert look(asking=False) == ({"quality"}, [])
    assert look(asking=True) == ({"quality", "gloss"}, ["seen"])


def test_a_later_stage_can_ask_for_a_measurement_too() -> None:
    world = World()
    run = world.run(
        {"stage": "matching", "when": [ALWAYS], "then": [{"measure": "measurement.depth"}]},
        {"stage": "matching", "when": [{"fact": "depth"}], "then": [{"choose": "matching.fine"}]},
    )
    assert matched(run) == "pair>fine1"
    assert world.log.count("probe depth") == 1


def test_a_probe_that_cannot_measure_is_noted_and_not_asked_again() -> None:
    world = World(depth_fails=True)
    run = world.run({"stage": "measurement", "when": [ALWAYS], "then": [{"measure": "measurement.depth"}]})
    assert matched(run) == "pair>plain1"
    assert run.notes == ["measurement.depth could not measure: it is too dark"]
    assert world.log.count("probe depth") == 1


def test_a_failing_operator_is_a_finding_and_the_next_trial_goes_on_without_it() -> None:
    world = World(broken={"matching.fine"}, scores={"pair>plain1": 0.9})
    run = world.run({"stage": "matching", "when": [ALWAYS], "then": [{"choose": "matching.fine"}]})
    assert matched(run) == "pair>plain1"
    assert [(trial.answer, trial.failure) for trial in run.trials] == [
        ("failed", "matching.fine: it is broken"),
        ("accepted", None),
    ]
    (finding,) = run.findings()
    assert (finding.name, finding.severity, finding.stage) == ("operator-failed", "minor", "matching")
    assert finding.sentence == "an operator could not do its work - matching.fine: it is broken"


def test_a_failure_that_leaves_its_slot_empty_is_a_major_finding() -> None:
    world = World(broken={"matching.fine"})
    run = world.run(
        {"stage": "matching", "when": [ALWAYS], "then": [{"choose": "matching.fine", "score": 0.9}]},
        {"stage": "matching", "when": [ALWAYS], "then": [{"choose": "none", "slot": "matcher"}]},
    )
    assert matched(run) == "pair"
    assert [finding.severity for finding in run.findings()] == ["major"]


def test_rules_can_answer_a_failure() -> None:
    world = World(broken={"matching.fine"})
    failed = {"fact": "failure", "field": "operator", "op": "eq", "value": "matching.fine"}
    run = world.run(
        {"stage": "matching", "when": [ALWAYS], "then": [{"choose": "matching.fine", "score": 0.9}]},
        {"stage": "matching", "when": [failed], "then": [{"choose": "matching.coarse"}]},
    )
    assert matched(run) == "pair>coarse1"


def test_when_everything_fails_there_is_no_product_and_a_major_finding() -> None:
    world = World(broken={"matching.fine", "matching.plain"})
    run = world.run({"stage": "matching", "when": [ALWAYS], "then": [{"choose": "matching.fine"}]})
    assert matched(run) is None
    assert world.log == ["matching.fine 1", "matching.plain 1"]
    assert {finding.severity for finding in run.findings()} == {"major"}


def test_an_adjusted_parameter_is_tried_and_the_better_trial_kept() -> None:
    world = World(scores={"pair>plain1": 0.2, "pair>plain3": 0.8})
    run = world.run(
        {"stage": "matching", "when": [POOR],
         "then": [{"assess": "poor"}, {"adjust": "matching.plain", "parameter": "level", "by": 2}]},
    )  # fmt: skip
    assert matched(run) == "pair>plain3"
    assert [(trial.number, trial.score, trial.kept) for trial in run.trials] == [(1, 0.2, False), (2, 0.8, True)]
    assert run.trials[0].answer == "change matching.plain level (TST001)"
    assert run.plans["matching"].steps[0].parameters == {"level": 3}
    assert run.findings() == ()  # the kept product is not poor


def test_the_first_trial_is_kept_where_the_second_is_worse() -> None:
    world = World(scores={"pair>plain1": 0.4, "pair>fine1": 0.3})
    run = world.run({"stage": "matching", "when": [POOR, FIRST], "then": [{"repair": "matching.fine"}]})
    assert matched(run) == "pair>plain1"
    assert [trial.kept for trial in run.trials] == [True, False]
    assert run.plans["matching"].operator_of("matcher") == "matching.plain"


def test_equal_scores_keep_the_earlier_trial() -> None:
    world = World(scores={"pair>plain1": 0.4, "pair>fine1": 0.4})
    run = world.run({"stage": "matching", "when": [POOR, FIRST], "then": [{"repair": "matching.fine"}]})
    assert matched(run) == "pair>plain1"


def test_of_equal_scores_the_trial_that_rules_find_less_wrong_with_is_kept() -> None:
    world = World(scores={"pair>plain1": 0.4, "pair>fine1": 0.4})
    run = world.run(
        {"stage": "matching", "when": [POOR, FIRST], "then": [{"assess": "poor"}, {"repair": "matching.fine"}]}
    )
    assert matched(run) == "pair>fine1"


def test_no_configuration_is_run_twice() -> None:
    world = World()
    run = world.run({"stage": "matching", "when": [POOR], "then": [{"repair": "matching.plain", "with": {"level": 1}}]})
    assert matched(run) == "pair>plain1"
    assert world.log == ["matching.plain 1"]


def test_trials_end_at_the_cap_even_if_the_rules_never_do() -> None:
    world = World()
    rules = [
        {"stage": "matching", "when": [POOR, {"fact": "trial", "field": "number", "op": "eq", "value": number}],
         "then": [{"adjust": "matching.plain", "parameter": "level", "by": 1}]}
        for number in range(1, 9)
    ]  # fmt: skip
    run = world.run(*rules)
    matched(run)
    assert len(run.trials) == MAX_TRIALS
    assert len(set(world.log)) == len(world.log) == MAX_TRIALS


def test_of_trials_without_a_score_the_last_one_that_is_of_use_is_kept() -> None:
    world = World(unscored=True)
    ruined = {"fact": "trial", "field": "number", "op": "eq", "value": 2}
    run = world.run(
        {"stage": "matching", "when": [FIRST], "then": [{"repair": "matching.fine"}]},
        {"stage": "matching", "when": [ruined], "then": [{"assess": "poor", "severity": "critical"}]},
    )
    assert matched(run) == "pair>plain1"
    assert not run.critical()


def test_an_earlier_stage_is_repaired_and_run_again() -> None:
    world = World(scores={"pair>plain1": 0.2, "pair>strong1>plain1": 0.9})
    run = world.run({"stage": "matching", "when": [POOR], "then": [{"repair": "correction.strong"}]})
    assert matched(run) == "pair>strong1>plain1"
    assert run.plans["correction"].operator_of("radiometry") == "correction.strong"
    assert run.trials[0].answer == "try correction.strong (TST001)"


def test_the_earlier_stage_goes_back_where_its_repair_was_worse() -> None:
    world = World(scores={"pair>mild1>plain1": 0.4, "pair>strong1>plain1": 0.3})
    run = world.run(
        {"stage": "correction", "when": [ALWAYS], "then": [{"choose": "correction.mild"}]},
        {"stage": "matching", "when": [POOR], "then": [{"repair": "correction.strong"}]},
    )
    assert matched(run) == "pair>mild1>plain1"
    assert run.plans["correction"].operator_of("radiometry") == "correction.mild"


def reconstructed(run: Run) -> Any:
    """Go on from `matched` to a reconstruction that is the matched product itself, measured by its score."""

    def matching(directives: Directives) -> str:
        return run.execute(run.plan("correction", directives), "pair")

    product = [matched(run)]

    def start(directives: Directives) -> str:
        if directives.touch(("correction", "matching")):
            product.append(run.run_again("matching", "disparity", directives, matching))
        return product[-1]

    return run.run_stage("reconstruction", "terrain", start)


def test_a_stage_can_be_repaired_from_two_stages_later() -> None:
    world = World(scores={"pair>plain1": 0.2, "pair>strong1>plain1": 0.9})
    run = world.run({"stage": "reconstruction", "when": [POOR], "then": [{"repair": "correction.strong"}]})
    assert reconstructed(run) == "pair>strong1>plain1"
    assert run.plans["correction"].operator_of("radiometry") == "correction.strong"


def test_a_repair_from_a_later_stage_keeps_what_the_trials_before_had_asked_for() -> None:
    world = World(scores={"pair>plain1": 0.2, "pair>plain3": 0.3, "pair>strong1>plain3": 0.9})
    run = world.run(
        {"stage": "matching", "when": [POOR, FIRST],
         "then": [{"adjust": "matching.plain", "parameter": "level", "by": 2}]},
        {"stage": "reconstruction", "when": [POOR], "then": [{"repair": "correction.strong"}]},
    )  # fmt: skip
    assert reconstructed(run) == "pair>strong1>plain3"
    assert run.plans["matching"].steps[0].parameters == {"level": 3}


def test_a_repair_that_fails_in_an_earlier_stage_keeps_the_earlier_product() -> None:
    world = World(scores={"pair>plain1": 0.2}, broken={"matching.fine"})
    run = world.run({"stage": "reconstruction", "when": [POOR], "then": [{"repair": "matching.fine"}]})
    assert reconstructed(run) == "pair>plain1"
    assert run.plans["matching"].operator_of("matcher") == "matching.plain"
    assert run.notes == ["reconstruction trial 2 ended in an earlier stage: matching.fine: it is broken"]


def test_a_repair_that_fails_does_not_exclude_the_operator_that_worked_before() -> None:
    world = World(scores={"pair>plain1": 0.2}, broken={"matching.plain 3"})
    run = world.run(
        {"stage": "matching", "when": [POOR],
         "then": [{"adjust": "matching.plain", "parameter": "level", "by": 2}]},
        {"stage": "matching", "when": [ALWAYS], "then": [{"choose": "matching.plain"}]},
    )  # fmt: skip
    assert matched(run) == "pair>plain1"
    assert world.log == ["matching.plain 1", "matching.plain 3"]
    assert [(finding.name, finding.severity) for finding in run.findings()] == [("operator-failed", "minor")]


def test_an_operator_that_failed_is_not_asked_again_by_a_later_stage() -> None:
    world = World(scores={"pair>plain1": 0.2, "pair>strong1>plain1": 0.9}, broken={"matching.fine"})
    run = world.run(
        {"stage": "matching", "when": [ALWAYS], "then": [{"choose": "matching.fine"}]},
        {"stage": "reconstruction", "when": [POOR], "then": [{"repair": "correction.strong"}]},
    )
    assert reconstructed(run) == "pair>strong1>plain1"
    assert world.log == ["matching.fine 1", "matching.plain 1", "correction.strong 1", "matching.plain 1"]


def test_what_failed_after_the_kept_trial_is_no_fact_where_a_later_stage_asks_for_that_one_again() -> None:
    world = World(scores={"pair>plain1": 0.2, "pair>strong1>plain1": 0.9}, broken={"matching.fine"})
    broken = {"fact": "failure", "field": "operator", "op": "eq", "value": "matching.fine"}
    run = world.run(
        {"stage": "matching", "when": [POOR], "then": [{"repair": "matching.fine"}]},
        {"stage": "matching", "when": [broken], "then": [{"derive": "seen", "severity": "minor"}]},
        {"stage": "reconstruction", "when": [POOR], "then": [{"repair": "correction.strong"}]},
    )
    assert reconstructed(run) == "pair>strong1>plain1"
    assert world.log == ["matching.plain 1", "matching.fine 1", "correction.strong 1", "matching.plain 1"]
    assert run.kept["matching"].number == 1
    assert [finding.name for finding in run.findings()] == ["operator-failed"]


def test_what_a_later_stage_asks_for_twice_is_run_once() -> None:
    world = World()
    run = world.run({"stage": "reconstruction", "when": [POOR], "then": [{"repair": "matching.coarse"}]})
    reconstructed(run)
    coarse = Candidate(operator="matching.coarse", rule="TST001", score=0.5, priority=0)
    asked = Directives(candidates={"matching.matcher": (coarse,)})
    products = [run.run_again("matching", "disparity", asked, lambda _: "pair") for _ in range(2)]
    assert products == ["pair>coarse1"] * 2
    assert world.log.count("matching.coarse 1") == 1


def test_a_later_stage_sees_what_an_earlier_one_ran() -> None:
    planned = {"fact": "planned", "field": "operator", "op": "eq", "value": "correction.mild"}
    run = World().run(
        {"stage": "correction", "when": [ALWAYS], "then": [{"choose": "correction.mild"}]},
        {"stage": "matching", "when": [planned], "then": [{"choose": "matching.fine"}]},
    )
    assert matched(run) == "pair>mild1>fine1"


def test_a_probe_of_the_product_that_fails_is_noted_and_the_product_kept() -> None:
    def broken(_: object) -> list[FactModel]:
        raise OperatorError("nothing to measure")

    run = World().run()
    probes: dict[str, Probe] = dict(run.knowledge.probes)
    probes["measurement.quality"] = replace(probes["measurement.quality"], function=broken)
    run.knowledge = replace(run.knowledge, probes=probes)
    assert matched(run) == "pair>plain1"
    assert run.notes == ["measurement.quality could not measure: nothing to measure"]


def test_progress_names_what_runs() -> None:
    said: list[str] = []
    run = World().run()
    run.progress = said.append
    matched(run)
    assert said == ["measuring", "matching.plain"]


def test_every_probe_and_operator_is_timed() -> None:
    run = World().run()
    matched(run)
    assert {"measurement.bright", "measurement.quality", "matching.plain", "inference"} <= set(run.timings_s)
    assert all(seconds >= 0 for seconds in run.timings_s.values())
