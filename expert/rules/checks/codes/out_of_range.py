"""`out-of-range`: a value that a field or a parameter cannot have."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from expert.facts import FieldInfo
from expert.rules.checks.check import Check
from expert.rules.checks.comparing import NUMERIC, comparable, constant, fits, same_unit_as
from expert.rules.checks.context import Context, RuleScope, values_of
from expert.rules.checks.parameters import assignments, interval_of, is_numeric, limits_of, plain, validation_fault
from expert.rules.model import Adjust
from expert.rules.problem import Problem, suggest
from expert.rules.reader import Path

_CODE = "out-of-range"


def _range_text(info: FieldInfo) -> str:
    low = "" if info.ge is None else f"{info.ge:g}"
    high = "" if info.le is None else f"{info.le:g}"
    unit = "" if info.unit == "1" else f" {info.unit}"
    return f"{low or 'any'} to {high or 'any'}{unit}"


def _value(scope: RuleScope, info: FieldInfo, op: str, value: Any, path: Path) -> Iterator[Problem]:
    """Check a constant against the field it is compared with."""
    if isinstance(value, str):
        if info.choices and value not in info.choices:
            yield scope.problem(path, _CODE, f"'{info.name}' is never {value!r}", suggest(value, info.choices))
    elif info.kind in NUMERIC:
        low, high = info.ge, info.le
        if op.startswith("abs_"):
            ends = [abs(end) for end in (low, high) if end is not None]
            low, high = 0.0, max(ends) if len(ends) == 2 else None
        if (low is not None and value < low) or (high is not None and value > high):
            message = f"value {value:g} is outside the range of '{info.name}', {_range_text(info)}"
            yield scope.problem(path, _CODE, message, "correct the value")


def _adjust(scope: RuleScope, action: Adjust, path: Path) -> Iterator[Problem]:
    operator = scope.context.operators.get(action.adjust)
    if operator is None or action.parameter not in operator.params.model_fields:
        return
    if not is_numeric(operator.params.model_fields[action.parameter].annotation):
        return
    low, high = limits_of(operator.params, action.parameter)
    for key, value in (("at_least", action.at_least), ("at_most", action.at_most)):
        if value is not None and not low <= value <= high:
            message = f"'{key}' is {value:g}, but '{action.parameter}' must be {low:g} to {high:g}"
            yield scope.problem((*path, key), _CODE, message, "correct the limit")


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for condition, where in scope.comparisons:
            info = comparable(scope, condition)
            for value, place in values_of(condition, where) if info else ():
                found = constant(scope, value)
                if info and found is not None and fits(info, found) and same_unit_as(scope, info, value):
                    yield from _value(scope, info, condition.op, found, place)
        for action, path in scope.actions:
            if isinstance(action, Adjust):
                yield from _adjust(scope, action, path)
    for item in assignments(context):
        if not item.known:
            continue
        if plain(item.operand):
            fault = validation_fault(item)
            if fault and fault[0] == _CODE:
                yield item.problem(_CODE, fault[1], "correct the value")
        elif item.scope is not None and is_numeric(item.operator.params.model_fields[item.parameter].annotation):
            interval, (low, high) = (
                interval_of(item.scope, item.operand),
                limits_of(item.operator.params, item.parameter),
            )
            if interval is not None and (interval[1] < low or interval[0] > high):
                found = f"{interval[0]:g} to {interval[1]:g}"
                message = f"{item.label} would be {found}, but must be {low:g} to {high:g}"
                yield item.problem(_CODE, message, "correct the formula")


CHECK = Check(
    _CODE,
    "error",
    "A value lies outside what its field or parameter can have.",
    "A comparison with such a value is always true or never; a parameter outside its range stops the plan.",
    "Correct the value; the ranges stand in the references of facts and operators.",
    _find,
)
