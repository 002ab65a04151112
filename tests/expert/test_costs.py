"""Plans under a time budget follow predicted costs, and say what they give up."""

from __future__ import annotations

import pytest
from synthetic_pairs import shifted_pair

from expert import Decision, ExpertSystem
from expert.costs import ALWAYS, Costs, measure_speed
from expert.facts import Fact
from expert.rules.model import RuleBase
from modules.catalog import operators, probes

PIXELS, COLUMNS = 640 * 480, 640
RANGE = Fact.of("disparity_range", min_px=0, max_px=64)


def predicted(known: list[Fact], speed: float = 1.0, pixels: int = PIXELS) -> dict[str, float]:
    costs = Costs(RuleBase(), operators(), probes(), pixels, COLUMNS, False, speed)
    return {str(fact.get("step")): fact.numbers["cpu_s"] for fact in costs.facts(known)}


def decided(budget: float | None, speed: float = 1.0) -> Decision:
    system = ExpertSystem(engine="compiled", time_budget_s=budget, machine_speed=speed)
    return system.decide(shifted_pair(disparity_range_px=(0, 24)))


def findings(decision: Decision) -> set[str]:
    return {finding.name for finding in decision.findings}


def test_every_matcher_and_every_probe_of_the_pair_has_a_cost() -> None:
    steps = predicted([RANGE])
    matchers = {name for name, item in operators().items() if item.slot == "matcher"}
    assert matchers | {name for name, probe in probes().items() if probe.subject == "pair"} | {ALWAYS} <= set(steps)
    assert (
        steps["matching.block_match"] < steps["matching.semi_global_block_match"] < steps["matching.semi_global_match"]
    )


def test_costs_are_those_of_the_model_over_the_known_range() -> None:
    model = operators()["matching.semi_global_match"].cost
    assert predicted([RANGE])["matching.semi_global_match"] == pytest.approx(model.seconds(PIXELS, 64), abs=1e-4)
    assert predicted([])["matching.semi_global_match"] == pytest.approx(model.seconds(PIXELS, 160), abs=1e-4)


@pytest.mark.parametrize(("same_rig", "disparities"), [(True, 32), (False, 160)])
def test_the_range_of_the_pair_before_is_assumed_where_the_rig_is_the_same(same_rig: bool, disparities: int) -> None:
    model = operators()["matching.semi_global_match"].cost
    before = Fact.of("previous", same_rig=same_rig, min_px=8, max_px=40)
    found = predicted([before])["matching.semi_global_match"]
    assert found == pytest.approx(model.seconds(PIXELS, disparities), abs=1e-4)
    assert predicted([before, RANGE]) == predicted([RANGE])


def test_twice_the_speed_halves_every_cost() -> None:
    one, two = predicted([RANGE]), predicted([RANGE], speed=2.0)
    assert all(two[name] == pytest.approx(one[name] / 2, abs=1e-4) for name in one)


def test_a_generous_budget_changes_nothing() -> None:
    free = ExpertSystem(engine="compiled").decide(shifted_pair(disparity_range_px=(0, 24)))
    generous = decided(60.0)
    assert generous.plans == free.plans
    assert findings(generous) == findings(free)


def test_smaller_budgets_give_up_more_and_say_so() -> None:
    said = [findings(decided(budget)) for budget in (60.0, 0.05, 0.0001)]
    assert "time-is-short" not in said[0]
    assert "budget-too-small" not in said[1]
    assert {"time-is-short", "smooth-matcher-unaffordable", "rows-unaffordable", "budget-too-small"} <= said[2]
    assert decided(0.0001).operator("matching.matcher") == "matching.block_match"


def test_a_faster_machine_does_more_in_the_same_time() -> None:
    slow, fast = decided(0.05, speed=0.125), decided(0.05, speed=8.0)
    assert slow.operator("matching.matcher") == "matching.block_match"
    assert fast.operator("matching.matcher") == "matching.semi_global_match"


def test_the_predicted_costs_stand_in_the_record_and_decide_again() -> None:
    decision = decided(0.05, speed=0.125)
    steps = {fact.fields["step"] for fact in decision.facts if fact.template == "cost"}
    assert {ALWAYS, "matching.block_match"} <= steps
    assert (
        "matching.block_match (MAT012) -> matching.semi_global_match"
        in decision.what_if({"task.time_budget_s": 60.0}).text()
    )


def test_a_question_about_time_that_the_record_cannot_answer_is_told() -> None:
    assert "were kept as recorded" in decided(5.0).what_if({"task.machine_speed": 0.125}).text()
    assert "no costs were predicted" in decided(None).what_if({"task.time_budget_s": 0.02}).text()


def test_why_not_names_the_limit_of_a_budget() -> None:
    answer = decided(5.0).why_not("MEA086").text()
    assert "the time_budget_s of task (called t) is below" in answer
    assert "measured 5 s" in answer


def test_speeds_are_told_in_eighths() -> None:
    speed = measure_speed()
    assert 0.125 <= speed <= 8.0
    assert speed * 8 == round(speed * 8)
