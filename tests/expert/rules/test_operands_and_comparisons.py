"""Operands and comparisons are total, and say no rather than guess."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import TypeAdapter

from expert.facts import Fact, FieldInfo, TemplateInfo
from expert.rules.evaluate import Evaluator, holds, operand_aliases, resolve
from expert.rules.model import Comparison, Operand, Threshold

THRESHOLDS = {"limit": Threshold(value=6.0, because="test")}
BINDINGS = {"a": Fact.of("a", x=1.5, n=3, s="u", t=True, bad=math.nan, sx=0.5)}


def operand(value: Any) -> Any:
    return TypeAdapter(Operand).validate_python(value)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (2, 2),
        ({"field": "a.x"}, 1.5),
        ({"field": "a.absent"}, None),
        ({"field": "b.x"}, None),
        ({"field": "a.bad"}, None),
        ({"threshold": "limit"}, 6.0),
        ({"threshold": "unknown"}, None),
        ({"add": [{"field": "a.x"}, 1, 2]}, 4.5),
        ({"sub": [1, {"field": "a.n"}]}, -2),
        ({"mul": [2, {"threshold": "limit"}]}, 12.0),
        ({"mul": [1e300, 1e300]}, None),
        ({"div": [1, 4]}, 0.25),
        ({"div": [1, 0]}, None),
        ({"add": [1, {"field": "a.s"}]}, None),
        ({"add": [1, {"field": "a.t"}]}, None),
        ({"add": [1, {"field": "a.absent"}]}, None),
        ({"clamp": [{"field": "a.n"}, 0, 2]}, 2),
        ({"min": [1, {"max": [0, 0.5]}]}, 0.5),
        ({"round": {"field": "a.x"}}, 2),
        ({"floor": {"field": "a.x"}}, 1),
        ({"ceil": {"field": "a.x"}}, 2),
    ],
)
def test_an_operand_has_its_value_or_none(value: Any, expected: Any) -> None:
    found = resolve(operand(value), BINDINGS, THRESHOLDS)
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize(
    ("op", "value", "limit", "expected"),
    [
        ("eq", 1, 1.0, True), ("eq", True, 1, False), ("eq", "u", "u", True), ("ne", "u", 1, False),
        ("ne", 1, 2, True), ("ne", None, 2, False), ("lt", 1, 2, True), ("lt", "a", "b", False), ("lt", True, 2, False),
        ("le", 2, 2, True), ("gt", 2, 2, False), ("ge", 2, 2, True), ("ge", None, 2, False),
        ("abs_lt", -1, 2, True), ("abs_le", -2, 2, True), ("abs_gt", -3, 2, True), ("abs_ge", -2, 2, True),
        ("between", 1, (1, 2), True), ("between", 2, (1, 2), True), ("between", 2.1, (1, 2), False),
        ("between", 1, 1, False), ("between", 1, (1, "b"), False),
        ("in", "u", ("u", "v"), True), ("in", 1, (True,), False), ("not_in", "w", ("u", "v"), True),
        ("not_in", None, ("u",), False), ("not_in", "u", ("u",), False), ("present", 0, None, True),
        ("present", None, None, False), ("absent", None, None, True), ("absent", False, None, False),
        ("gt", 2, None, False),
    ],
)  # fmt: skip
def test_a_comparison_holds_only_between_comparable_values(op: str, value: Any, limit: Any, expected: bool) -> None:
    assert holds(op, value, limit) is expected


@pytest.mark.parametrize(
    ("op", "limit", "expected"),
    [
        ("significantly_gt", 0.4, True),
        ("significantly_gt", 0.5, False),
        ("significantly_lt", 2.6, True),
        ("significantly_lt", 2.5, False),
    ],
)
def test_a_significant_difference_is_more_than_two_uncertainties(op: str, limit: float, expected: bool) -> None:
    fields = {"x": FieldInfo("x", "number", "1", "x", sigma="sx"), "n": FieldInfo("n", "number", "1", "n")}
    evaluator = Evaluator({"a": TemplateInfo("a", "a", fields, ())}, THRESHOLDS)
    comparison = Comparison.model_validate({"fact": "a", "field": "x", "op": op, "value": limit})
    assert evaluator.comparison(comparison, BINDINGS) is expected
    uncertain = {"a": Fact.of("a", x=100.0)}
    assert not evaluator.comparison(comparison, uncertain)
    without = Comparison.model_validate({"fact": "a", "field": "n", "op": op, "value": limit})
    assert not evaluator.comparison(without, BINDINGS)


def test_a_limit_may_be_a_list_with_thresholds() -> None:
    evaluator = Evaluator({}, THRESHOLDS)
    for name, expected in (("limit", True), ("unknown", False)):
        value = [1, {"threshold": name}]
        comparison = Comparison.model_validate({"fact": "a", "field": "n", "op": "between", "value": value})
        assert evaluator.comparison(comparison, BINDINGS) is expected


def test_an_alias_bound_to_another_template_never_matches() -> None:
    comparison = Comparison.model_validate({"fact": "b", "as": "a", "field": "x", "op": "absent"})
    assert not Evaluator({}, {}).comparison(comparison, BINDINGS)


def test_the_aliases_of_an_operand_are_found_at_any_depth() -> None:
    value = operand({"add": [{"field": "a.x"}, {"mul": [2, {"field": "b.y"}]}]})
    assert operand_aliases(value) == {"a", "b"}
