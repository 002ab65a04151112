from __future__ import annotations

import pytest

from expert.facts import vocabulary
from expert.rules.diff import Difference, rule_differences
from expert.rules.load import load_rules
from expert.rules.model import RuleBase
from modules.catalog import operators, probes

WORDS = vocabulary(probes().values())


def base(**changes):
    rule = {
        "id": "COR001",
        "name": "dark",
        "stage": "correction",
        "when": [
            {"fact": "brightness", "field": "mean_difference_dn", "op": "abs_ge", "value": {"threshold": "dark_dn"}},
            {"fact": "task", "field": "profile", "op": "eq", "value": "fast"},
        ],
        "then": [{"choose": "correction.match_histograms", "score": 0.8}],
        "because": "it is needed for a test",
        "references": ["test"],
    }
    whole = {
        "thresholds": {"dark_dn": {"value": 6.0, "unit": "dn", "because": "a test"}},
        "findings": {"dark": "it is dark"},
        "slots": {"correction": [{"slot": "radiometry", "because": "a"}, {"slot": "local", "because": "b"}]},
        "rules": [{**rule, **changes.pop("rule", {})}, *changes.pop("rules", [])],
    }
    return RuleBase.model_validate({**whole, **changes})


def differences(**changes):
    return rule_differences(base(), base(**changes), WORDS)


def test_a_rule_base_does_not_differ_from_itself_in_another_order():
    loaded = load_rules(None, WORDS, operators(), probes()).base
    turned = loaded.model_copy(update={"rules": list(reversed(loaded.rules))})
    assert rule_differences(loaded, turned, WORDS) == []


def test_a_moved_threshold_names_the_rules_that_use_it():
    moved = {"dark_dn": {"value": 7.5, "unit": "dn", "because": "a test"}}
    assert differences(thresholds=moved) == [
        Difference("changed", "threshold dark_dn (COR001)", "value", "6 dn", "7.5 dn")
    ]


@pytest.mark.parametrize(
    ("rule", "line"),
    [
        ({"priority": 120}, "changed  rule COR001, priority: 100 -> 120"),
        (
            {"then": [{"choose": "correction.match_histograms", "score": 0.9}]},
            "changed  rule COR001, action: choose correction.match_histograms (score 0.8) -> "
            "choose correction.match_histograms (score 0.9)",
        ),
        (
            {"when": [{"fact": "task", "field": "profile", "op": "eq", "value": "best"}]},
            None,
        ),
        (
            {"because": "it is still needed"},
            "reworded rule COR001, because: it is needed for a test -> it is still needed",
        ),
    ],
)
def test_a_changed_rule_is_told_in_words(rule, line):
    found = [str(item) for item in differences(rule=rule)]
    if line is not None:
        assert found == [line]
    else:
        assert len(found) == 2
        assert all(item.startswith("changed  rule COR001, condition: ") for item in found)


def test_a_dropped_condition_and_an_added_one_are_told_alone():
    kept = base().rules[0].model_dump(by_alias=True, exclude_none=True)["when"][:1]
    assert [str(item) for item in differences(rule={"when": kept})] == [
        "changed  rule COR001, condition: no longer the profile of task is fast"
    ]
    back = rule_differences(base(rule={"when": kept}), base(), WORDS)
    assert [str(item) for item in back] == ["changed  rule COR001, condition: now also the profile of task is fast"]


def test_added_and_removed_items_are_told_whole():
    found = {(item.how, item.what) for item in differences(thresholds={}, findings={"new": "a new one"}, rules=[])}
    assert found == {("removed", "threshold dark_dn (COR001)"), ("removed", "finding dark"), ("added", "finding new")}
    other = base().rules[0].model_copy(update={"id": "COR002"})
    assert [(item.how, item.what) for item in differences(rules=[other.model_dump(by_alias=True)])] == [
        ("added", "rule COR002")
    ]


def test_slots_differ_by_default_by_order_and_by_presence():
    one, two = {"slot": "radiometry", "because": "a"}, {"slot": "local", "because": "b"}
    filled = {**one, "default": "correction.match_histograms", "with": {"channels": "each"}}
    assert [str(item) for item in differences(slots={"correction": [filled, two]})] == [
        "changed  slot correction.radiometry, default: none -> correction.match_histograms with channels each"
    ]
    assert [str(item) for item in differences(slots={"correction": [two, one]})] == [
        "changed  slots of correction, order: radiometry, local -> local, radiometry"
    ]
    assert [str(item) for item in differences(slots={"correction": [one]})] == ["removed  slot correction.local: none"]
