"""The direct reading of conditions agrees with the compiled engine, and finds the condition that decides."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from expert.engine import make_engine
from expert.facts import Fact
from expert.rules.margin import Judge
from expert.rules.model import Rule, RuleBase

LEFT = {"fact": "side", "as": "l", "field": "side", "op": "eq", "value": "left"}
RIGHT = {"fact": "side", "as": "r", "field": "side", "op": "eq", "value": "right"}
DARK = {"fact": "side", "as": "x", "field": "mean_dn", "op": "lt", "value": 100}
BRIGHTER = {"fact": "side", "as": "l", "field": "mean_dn", "op": "gt", "value": {"field": "r.mean_dn"}}
OFFSET = {"fact": "brightness", "field": "offset_dn", "op": "abs_ge", "value": 6}
WHENS = (
    [LEFT, RIGHT, BRIGHTER],
    [OFFSET, {"not": DARK}],
    [{"any_of": [OFFSET, [DARK, {"finding": "differs", "at_least": "major"}]]}],
    [{"exists": [LEFT, RIGHT, BRIGHTER]}],
    [{"fact": "brightness"}, {"for_all": {"where": [{"fact": "side", "as": "x"}], "then": [DARK]}}],
    [OFFSET, {"not": [LEFT, {"not": {"finding": "differs"}}]}],
    [LEFT, {"not": {"fact": "side", "field": "mean_dn", "op": "gt", "value": {"field": "l.mean_dn"}}}],
)
_SIDES = st.builds(
    lambda side, mean: Fact.of("side", side=side, mean_dn=mean),
    st.sampled_from(["left", "right"]),
    st.sampled_from([None, 50.0, 100.0, 150.0]),
)
_FACTS = st.tuples(
    st.lists(_SIDES, max_size=3),
    st.sampled_from([(), (Fact.of("brightness", offset_dn=-6.0),), (Fact.of("brightness", offset_dn=5.0),)]),
    st.sampled_from([(), (Fact.of("finding", name="differs", severity="major"),)]),
)


def rule_of(when):
    return Rule.model_validate(
        {
            "id": "COR001", "name": "under-test", "stage": "correction", "when": when,
            "then": [{"measure": "measurement.sides"}], "because": "It is a test.", "references": ["none"],
        }
    )  # fmt: skip


@pytest.mark.parametrize("when", WHENS, ids=range(len(WHENS)))
@seed(4)
@settings(max_examples=60, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow])
@given(parts=_FACTS)
def test_a_condition_fails_exactly_when_the_engine_does_not_fire(when, parts, words):
    facts = frozenset(fact for part in parts for fact in part)
    base = RuleBase(rules=[rule_of(when)])
    fired = bool(make_engine("compiled", words).infer(base, "correction", facts).firings)
    assert (Judge(base, words, facts).first_failing(base.rules[0]) is None) == fired


def test_the_binding_that_gets_furthest_is_reported(words):
    base = RuleBase(rules=[rule_of([LEFT, RIGHT, BRIGHTER])])
    facts = [Fact.of("side", side="left", mean_dn=100.0), Fact.of("side", side="right", mean_dn=130.0)]
    deciding = Judge(base, words, facts).first_failing(base.rules[0])
    assert str(deciding).endswith("is above the mean_dn of r: measured 100.0, limit 130.0, margin 30")


def test_a_missing_fact_is_named(words):
    base = RuleBase(rules=[rule_of([OFFSET])])
    assert "there is no such fact" in str(Judge(base, words, []).first_failing(base.rules[0]))


def test_only_ordered_comparisons_have_a_boundary(words):
    base = RuleBase(rules=[rule_of([LEFT, DARK])])
    judge = Judge(base, words, [Fact.of("side", side="left", mean_dn=50.0)])
    assert not judge.at_boundary(base.rules[0])
    judge = Judge(base, words, [Fact.of("side", side="left", mean_dn=100.0)])
    assert judge.at_boundary(base.rules[0])


def test_a_changed_copy_of_a_rule_base_knows_its_own_rules() -> None:
    base = RuleBase(rules=[rule_of([LEFT, RIGHT, BRIGHTER])])
    assert len(base.by_id) == 1
    assert base.model_copy(update={"rules": []}).by_id == {}
