from __future__ import annotations

from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from expert.firing import Firing, ResolvedAction
from expert.plan import NONE, Adjustment, Directives, PlanError, StagePlan, adjustments, proposals, settle
from expert.rules.model import Repair, Rule, RuleBase
from modules.operator import Cost, Operator, OperatorParams


class _Params(OperatorParams):
    size_px: int = Field(3, ge=1, le=31, description="Size, px")
    strength: float = Field(0.5, ge=0.0, le=1.0, description="Strength")
    mode: Literal["a", "b"] = Field("a", description="Mode")


def _operator(name: str, slot: str) -> Operator:
    return Operator(name, slot, _Params, lambda state, params: state, Cost(), "Does nothing")


OPERATORS = {
    operator.name: operator
    for operator in (
        _operator("correction.first", "radiometry"),
        _operator("correction.second", "radiometry"),
        _operator("correction.third", "radiometry"),
        _operator("correction.smooth", "denoise"),
    )
}
SLOTS = {
    "correction": [
        {"slot": "denoise", "default": "correction.smooth", "with": {"size_px": 5}, "because": "a test"},
        {"slot": "radiometry", "default": "none", "because": "a test"},
    ]
}


def _rule(number: int, *actions: dict[str, Any], priority: int = 100) -> Rule:
    return Rule(
        id=f"TST{number:03d}",
        name=f"rule-{number}",
        stage="correction",
        priority=priority,
        when=[{"fact": "task"}],
        then=list(actions),
        because="it is needed for a test",
        references=["test"],
    )


def _resolved(rule: Rule) -> Firing:
    found = []
    for index, action in enumerate(rule.then):
        kind = next(name for name in ("choose", "repair", "exclude", "set", "adjust") if hasattr(action, name))
        values = {"to": action.to} if kind == "set" else getattr(action, "with_", {})
        found.append(ResolvedAction(index, kind, tuple(values.items())))
    return Firing(rule.id, (), tuple(found))


def _settled(*rules: Rule, directives: Directives | None = None, failed: frozenset[str] = frozenset()) -> StagePlan:
    base = RuleBase(slots=SLOTS, rules=list(rules))
    firings = [_resolved(rule) for rule in rules]
    return settle(base, "correction", firings, OPERATORS, directives or Directives(), failed)


def test_the_default_fills_a_slot_with_its_own_parameters_when_no_rule_chooses() -> None:
    plan = _settled()
    assert [step.slot for step in plan.steps] == ["denoise", "radiometry"]
    assert plan.operator_of("denoise") == "correction.smooth"
    assert plan.steps[0].parameters == {"size_px": 5, "strength": 0.5, "mode": "a"}
    assert plan.steps[0].chosen_by is None
    assert plan.steps[0].set_by == {"size_px": "default"}
    assert plan.operator_of("radiometry") == NONE


def test_the_default_loses_to_any_rule_even_at_score_zero() -> None:
    plan = _settled(_rule(1, {"choose": "none", "slot": "denoise", "score": 0.0}))
    assert plan.operator_of("denoise") == NONE
    assert plan.steps[0].chosen_by == "TST001"
    assert [(loser.operator, loser.lost_because) for loser in plan.steps[0].losers] == [
        ("correction.smooth", "the default loses to any rule's choice")
    ]


def test_the_higher_score_wins_whatever_the_priority() -> None:
    plan = _settled(
        _rule(1, {"choose": "correction.first", "score": 0.6}, priority=900),
        _rule(2, {"choose": "correction.second", "score": 0.7}, priority=1),
    )
    assert plan.operator_of("radiometry") == "correction.second"
    assert plan.steps[1].losers[0].lost_because == "score 0.6 is below 0.7 of correction.second (TST002)"


def test_at_equal_score_the_higher_priority_wins() -> None:
    plan = _settled(
        _rule(1, {"choose": "correction.first", "score": 0.6}, priority=100),
        _rule(2, {"choose": "correction.second", "score": 0.6}, priority=101),
    )
    assert plan.operator_of("radiometry") == "correction.second"
    assert plan.steps[1].losers[0].lost_because == "same score, priority 100 is below 101 (TST002)"


def test_at_equal_score_and_priority_the_first_id_wins() -> None:
    plan = _settled(
        _rule(2, {"choose": "correction.second", "score": 0.6}),
        _rule(1, {"choose": "correction.first", "score": 0.6}),
    )
    assert plan.operator_of("radiometry") == "correction.first"
    assert plan.steps[1].losers[0].lost_because == "same score and priority, TST001 comes first by id"


@given(
    scores=st.lists(st.sampled_from([0.2, 0.5, 0.9]), min_size=3, max_size=3),
    priorities=st.lists(st.sampled_from([1, 100]), min_size=3, max_size=3),
    order=st.permutations([0, 1, 2]),
)
def test_the_order_of_firing_never_matters(scores: list[float], priorities: list[int], order: list[int]) -> None:
    names = ["correction.first", "correction.second", "correction.third"]
    rules = [
        _rule(
            index + 1,
            {"choose": name, "score": scores[index]},
            {"set": name, "parameter": "size_px", "to": index + 1, "score": scores[index]},
            priority=priorities[index],
        )
        for index, name in enumerate(names)
    ]
    assert _settled(*rules) == _settled(*(rules[index] for index in order))


def test_an_excluded_operator_loses_and_the_next_best_fills_the_slot() -> None:
    plan = _settled(
        _rule(1, {"choose": "correction.first", "score": 0.9}),
        _rule(2, {"choose": "correction.second", "score": 0.1}),
        _rule(3, {"exclude": "correction.first"}),
    )
    assert plan.operator_of("radiometry") == "correction.second"
    assert plan.steps[1].losers[0].lost_because == "excluded by TST003"


def test_the_default_answers_when_all_candidates_are_excluded() -> None:
    plan = _settled(_rule(1, {"choose": "correction.first"}), _rule(2, {"exclude": "correction.first"}))
    assert plan.operator_of("radiometry") == NONE
    assert plan.steps[1].chosen_by is None


def test_an_operator_that_failed_is_excluded_and_the_reason_says_so() -> None:
    plan = _settled(_rule(1, {"choose": "correction.first"}), failed=frozenset({"correction.first"}))
    assert plan.operator_of("radiometry") == NONE
    assert plan.steps[1].losers[0].lost_because == "excluded by a failure in an earlier trial"


def test_settings_compete_with_the_values_of_the_choice_on_the_same_terms() -> None:
    plan = _settled(
        _rule(1, {"choose": "correction.first", "with": {"size_px": 7, "mode": "b"}, "score": 0.6}),
        _rule(2, {"set": "correction.first", "parameter": "size_px", "to": 9, "score": 0.7}),
        _rule(3, {"set": "correction.first", "parameter": "mode", "to": "a", "score": 0.5}),
    )
    step = plan.steps[1]
    assert step.parameters == {"size_px": 9, "strength": 0.5, "mode": "b"}
    assert step.set_by == {"size_px": "TST002", "mode": "TST001"}
    assert {(lost.parameter, lost.value, lost.rule, lost.lost_because) for lost in step.lost_settings} == {
        ("size_px", 7, "TST001", "TST002 ranks first"),
        ("mode", "a", "TST003", "TST001 ranks first"),
    }


def test_a_setting_of_an_operator_that_is_not_chosen_changes_nothing() -> None:
    rules = [_rule(1, {"choose": "correction.first"})]
    other = _rule(2, {"set": "correction.second", "parameter": "size_px", "to": 9})
    assert _settled(*rules, other) == _settled(*rules)


def test_one_rule_that_fires_twice_alike_is_one_candidate() -> None:
    rule = _rule(1, {"choose": "correction.first"})
    base = RuleBase(slots=SLOTS, rules=[rule])
    plan = settle(base, "correction", [_resolved(rule), _resolved(rule)], OPERATORS, Directives())
    assert [loser.rule for loser in plan.steps[1].losers] == [None]


@pytest.mark.parametrize(
    ("step", "start", "expected"),
    [
        ({"by": 4.0}, 10, 14),
        ({"times": 1.35}, 10, 14),  # 13.5 rounds to even, and an integer stays an integer
        ({"times": 10.0, "at_most": 31}, 10, 31),
        ({"by": -100.0, "at_least": 1}, 10, 1),
        ({"times": 2.0, "by": 0.25}, 0.25, 0.75),
    ],
)
def test_an_adjustment_is_a_step_within_the_bounds_of_its_rule(
    step: dict[str, float], start: float, expected: float
) -> None:
    value = Adjustment(operator="correction.smooth", parameter="size_px", rule="TST001", **step).apply(start)
    assert value == expected
    assert type(value) is type(start)


def test_adjustments_change_the_settled_value_and_name_their_rule() -> None:
    rule = _rule(1, {"adjust": "correction.smooth", "parameter": "size_px", "by": 2})
    steps = adjustments({rule.id: rule}, [_resolved(rule), _resolved(rule)])
    assert len(steps) == 1
    plan = _settled(directives=Directives(adjustments=steps))
    assert plan.steps[0].parameters["size_px"] == 7
    assert plan.steps[0].set_by["size_px"] == "TST001"


def test_an_adjustment_stops_at_the_range_of_the_parameter() -> None:
    step = Adjustment(operator="correction.smooth", parameter="size_px", rule="TST001", times=100.0)
    assert _settled(directives=Directives(adjustments=(step,))).steps[0].parameters["size_px"] == 31
    step = Adjustment(operator="correction.smooth", parameter="strength", rule="TST001", by=-3.0)
    assert _settled(directives=Directives(adjustments=(step,))).steps[0].parameters["strength"] == 0.0


def test_a_repair_competes_with_the_choices_of_the_next_trial() -> None:
    choice = _rule(1, {"choose": "correction.first", "score": 0.8})
    repair = _rule(2, {"repair": "correction.second", "with": {"size_px": 11}, "score": 0.9})
    rules = {rule.id: rule for rule in (choice, repair)}
    found = proposals(rules, [_resolved(choice), _resolved(repair)], OPERATORS, (Repair,))
    assert list(found) == ["correction.radiometry"]
    directives = Directives(candidates={key: tuple(value) for key, value in found.items()})
    plan = _settled(choice, directives=directives)
    assert plan.operator_of("radiometry") == "correction.second"
    assert plan.steps[1].parameters["size_px"] == 11


def test_a_value_outside_its_range_is_refused_with_operator_parameter_and_value() -> None:
    rule = _rule(1, {"choose": "correction.first", "with": {"size_px": 99}})
    with pytest.raises(PlanError) as error:
        _settled(rule)
    assert str(error.value) == "correction.first: size_px: Input should be less than or equal to 31, got 99"


def test_an_unknown_parameter_is_refused_by_name() -> None:
    rule = _rule(1, {"choose": "correction.first", "with": {"sise_px": 9}})
    with pytest.raises(PlanError, match=r"^correction\.first: sise_px: Extra inputs are not permitted, got 9$"):
        _settled(rule)


def test_an_unknown_default_is_refused_by_name() -> None:
    base = RuleBase(
        slots={"correction": [{"slot": "denoise", "default": "correction.lost", "because": "a test"}]}, rules=[]
    )
    with pytest.raises(PlanError, match=r"^slot correction\.denoise: there is no operator 'correction\.lost'$"):
        settle(base, "correction", [], OPERATORS, Directives())


def test_equal_plans_have_equal_configurations_whoever_chose_them() -> None:
    one = _settled(_rule(1, {"choose": "correction.first", "with": {"size_px": 3}}))
    other = _settled(_rule(2, {"choose": "correction.first"}))
    assert one != other
    assert one.configuration() == other.configuration()
    changed = _settled(_rule(1, {"choose": "correction.first", "with": {"size_px": 4}}))
    assert changed.configuration() != one.configuration()
