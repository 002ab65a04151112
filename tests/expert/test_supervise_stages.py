"""The loop across stages: repairs of earlier ones, and what later ones know."""

from __future__ import annotations

from typing import Any

from toy_loop import ALWAYS, FIRST, POOR, World, matched

from expert.plan import Candidate, Directives
from expert.supervise import Run


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
