from __future__ import annotations

import pytest

from expert.engine import make_engine
from expert.facts import Fact
from expert.rules.counterexample import counterexamples


@pytest.fixture
def differ(load, good_text, words):
    """Return the examples on which a changed text of the rules differs from the sound one."""

    def compare(*changes, given=None):
        text = good_text
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        return counterexamples(
            load(good_text).base, load(text).base, words, make_engine("compiled", words), given or {}
        )

    return compare


def test_a_strict_comparison_differs_at_the_limit_itself(differ):
    (example,) = differ(("op: abs_ge", "op: abs_gt"))
    assert str(example) == (
        "e.g. COR001, given brightness offset_dn 6.0: note the major finding exposure-differs -> stays quiet"
    )
    assert example.as_dict()["facts"] == [{"fact": "brightness", "offset_dn": 6.0}]


def test_a_moved_threshold_differs_between_the_limits(differ):
    (example,) = differ(("value: 6.0", "value: 9.0"))
    (fact,) = example.facts
    assert 6.0 <= abs(fact.get("offset_dn")) < 9.0
    assert (example.rule, example.after) == ("COR001", ())


def test_an_example_begins_with_the_facts_of_the_cases(differ):
    given = (
        Fact.of("brightness", offset_dn=20.0, clipped_fraction=0.01),
        Fact.of("finding", name="exposure-differs", severity="major"),
    )
    (example,) = differ(("channels: gray", "channels: each"), given={"COR002": [frozenset(given)]})
    assert set(example.facts) == set(given)
    assert "channels gray" in example.before[0]
    assert "channels each" in example.after[0]


def test_a_value_that_is_calculated_otherwise_is_a_difference(differ):
    (example,) = differ(("100]}, 0, 1]", "50]}, 0, 1]"))
    assert example.rule == "COR002"
    assert example.before != example.after


def test_rules_that_mean_the_same_have_no_example(differ):
    assert differ() == []
    assert differ(("because: One lookup", "because: A lookup"), ("score: 0.8", "score: 0.80")) == []
