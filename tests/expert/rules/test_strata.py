"""Rules that negate findings come after the rules that derive them."""

from __future__ import annotations

from typing import Any

import pytest

from expert.rules.model import Rule
from expert.rules.strata import CyclicNegation, stratify


def rule(name: str, when: list[Any], derives: str) -> Rule:
    return Rule.model_validate(
        {
            "id": name, "name": "test", "stage": "matching", "when": when, "then": [{"derive": derives}],
            "because": "because of a test", "references": ["test"],
        }
    )  # fmt: skip


def layers(*rules: Rule) -> list[list[str]]:
    return [[each.id for each in layer] for layer in stratify(rules)]


def test_rules_without_negation_share_one_layer() -> None:
    assert layers(rule("BBB001", [{"finding": "a"}], "b"), rule("AAA001", [{"finding": "b"}], "a")) == [
        ["AAA001", "BBB001"]
    ]


@pytest.mark.parametrize(
    "group",
    [
        {"not": {"finding": "a"}},
        {"not": [{"fact": "x"}, {"any_of": [{"finding": "a"}]}]},
        {"for_all": {"where": [{"finding": "a"}], "then": [{"fact": "x"}]}},
        {"for_all": {"where": [{"fact": "x"}], "then": [{"finding": "a"}]}},
        {"not": {"fact": "finding", "as": "f", "field": "name", "op": "eq", "value": "a"}},
        {"exists": {"not": {"finding": "a"}}},
    ],
)
def test_a_negated_finding_starts_a_new_layer(group: dict[str, Any]) -> None:
    assert layers(rule("AAA001", [group], "b"), rule("BBB001", [{"fact": "x"}], "a")) == [["BBB001"], ["AAA001"]]


def test_exists_and_any_of_do_not_wait() -> None:
    waiting = rule("AAA001", [{"exists": {"finding": "a"}}, {"any_of": [{"finding": "a"}]}], "b")
    assert layers(waiting, rule("BBB001", [{"finding": "b"}], "a")) == [["AAA001", "BBB001"]]


def test_asking_for_the_absence_of_any_finding_is_a_cycle_for_a_rule_that_derives_one() -> None:
    with pytest.raises(CyclicNegation, match="rules AAA001 -> AAA001"):
        stratify([rule("AAA001", [{"not": {"fact": "finding"}}], "b")])


def test_the_shortest_cycle_is_named_in_order() -> None:
    rules = [
        rule("AAA001", [{"not": {"finding": "c"}}], "a"),
        rule("BBB001", [{"finding": "a"}], "b"),
        rule("CCC001", [{"finding": "b"}], "c"),
        rule("DDD001", [{"finding": "c"}], "d"),
    ]
    with pytest.raises(CyclicNegation) as error:
        stratify(rules)
    assert error.value.rules == ("AAA001", "CCC001", "BBB001")
