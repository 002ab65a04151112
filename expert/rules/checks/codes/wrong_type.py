"""`wrong-type`: a number where text is needed, one value instead of a list, and the like."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from expert.facts import FieldInfo
from expert.rules.checks.check import Check
from expert.rules.checks.comparing import NUMERIC, ORDERED, comparable, constant, fits, list_fault
from expert.rules.checks.context import Context, RuleScope, one_operation, parts_of, values_of
from expert.rules.checks.parameters import Assignment, assignments, interval_of, is_numeric, plain, validation_fault
from expert.rules.model import Adjust, Calculation, Comparison, FieldRef
from expert.rules.problem import Problem
from expert.rules.reader import Path

_CODE = "wrong-type"


def _value(scope: RuleScope, info: FieldInfo, value: Any, path: Path) -> Iterator[Problem]:
    """Check one value against the field it is compared with."""
    if isinstance(value, FieldRef):
        other = scope.field_of(value)
        if other is None or (info.kind in NUMERIC and other.kind in NUMERIC) or info.kind == other.kind:
            return
        message = f"'{info.name}' is a {info.kind}, '{value.field}' a {other.kind}"
        yield scope.problem(path, _CODE, message, "compare fields of one kind")
    elif isinstance(value, Calculation):
        if info.kind not in NUMERIC:
            yield scope.problem(path, _CODE, f"'{info.name}' is {info.kind}, not a number", "compare it with a value")
        elif interval_of(scope, value, inside=True) is None:
            message = f"'{info.name}' is a number, but the formula it is compared with is none"
            yield scope.problem(path, _CODE, message, "calculate with numbers")
    else:
        found = constant(scope, value)
        if found is not None and not fits(info, found):
            wanted = {"text": "text", "boolean": "true or false"}.get(info.kind, "a number")
            message = f"'{info.name}' is {wanted}, but is compared with {found!r}"
            yield scope.problem(path, _CODE, message, f"write {wanted}")


def _comparison(scope: RuleScope, condition: Comparison, path: Path) -> Iterator[Problem]:
    info = scope.info(condition)
    compared = condition.op not in ("present", "absent") and condition.field is not None and condition.value is not None
    if compared and (wanted := list_fault(condition)):
        hint = (
            "correct the list" if isinstance(condition.value, list) and wanted != "one value" else "correct the value"
        )
        yield scope.problem((*path, "value"), _CODE, f"'{condition.op}' needs {wanted}", hint)
    if info is None:
        return
    if condition.op in ORDERED and info.kind not in NUMERIC:
        message = f"'{condition.op}' compares numbers, but '{info.name}' is {info.kind}"
        yield scope.problem((*path, "op"), _CODE, message, "use eq, ne, in or not_in")
    elif condition.op.startswith("significantly") and info.sigma is None:
        message = f"'{info.name}' has no uncertainty, so '{condition.op}' cannot be decided"
        yield scope.problem((*path, "op"), _CODE, message, "use gt or lt")
    elif comparable(scope, condition):
        for value, where in values_of(condition, path):
            yield from _value(scope, info, value, where)


def _parameter(item: Assignment) -> Iterator[Problem]:
    if plain(item.operand):
        fault = validation_fault(item)
        if fault and fault[0] == _CODE:
            yield item.problem(_CODE, fault[1], "correct the value")
    elif item.scope is not None:
        numeric = is_numeric(item.operator.params.model_fields[item.parameter].annotation)
        if numeric and interval_of(item.scope, item.operand) is None:
            yield item.problem(_CODE, f"{item.label} is a number, but the value is not", "give it a number")
        elif not numeric and isinstance(item.operand, Calculation):
            message = f"{item.label} is not a number, but the value is calculated"
            yield item.problem(_CODE, message, "give it a value")


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for condition, path in scope.comparisons:
            yield from _comparison(scope, condition, path)
        for use in scope.operands:
            if isinstance(use.operand, Calculation) and one_operation(use.operand):
                name = use.operand.operation()[0]
                for part, where in parts_of(use.operand, use.path):
                    if isinstance(part, bool | str):
                        message = f"{name} cannot calculate with {'text ' if isinstance(part, str) else ''}{part!r}"
                        yield scope.problem(where, _CODE, message, "use a number")
        for action, path in scope.actions:
            if isinstance(action, Adjust) and action.adjust in context.operators:
                fields = context.operators[action.adjust].params.model_fields
                if action.parameter in fields and not is_numeric(fields[action.parameter].annotation):
                    message = f"parameter '{action.parameter}' of '{action.adjust}' is not a number"
                    hint = "repair with another value instead"
                    yield scope.problem((*path, "parameter"), _CODE, message, hint)
    for item in assignments(context):
        if item.known:
            yield from _parameter(item)


CHECK = Check(
    _CODE,
    "error",
    "A value is of another kind than what stands there has to be: a number, text, true or false, a list, a mapping.",
    "A comparison between values of different kinds is false for ever, and an operator refuses such a parameter.",
    "Write the kind of value that the message names; text such as 'yes' or '1' needs quotes, numbers must have none.",
    _find,
)
