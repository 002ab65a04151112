"""The loop within one stage."""

from __future__ import annotations

from dataclasses import replace

import pytest
from toy_loop import ALWAYS, FIRST, POOR, Depth, World, matched

from expert.costs import Costs
from expert.facts import Task, to_fact
from expert.supervise import MAX_TRIALS
from modules.operator import OperatorError
from modules.probe import FactModel, Probe


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
