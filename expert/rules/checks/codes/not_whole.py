"""`not-whole`: a formula that may give a fraction where a whole number is needed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, RuleScope
from expert.rules.checks.parameters import assignments
from expert.rules.model import Calculation, FieldRef, Quantity, ThresholdRef
from expert.rules.problem import Problem


def _whole(scope: RuleScope, operand: Any) -> bool:
    """Say whether an operand is a whole number whatever the facts are."""
    if isinstance(operand, Calculation):
        name, operands = operand.operation()
        return name in ("round", "floor", "ceil") or (name != "div" and all(_whole(scope, item) for item in operands))
    if isinstance(operand, FieldRef):
        info = scope.field_of(operand, inside=False)
        return info is not None and info.kind == "integer"
    if isinstance(operand, ThresholdRef):
        threshold = scope.context.threshold(operand.threshold)
        return threshold is not None and threshold.value.is_integer()
    if isinstance(operand, Quantity):
        return operand.value.is_integer()
    return isinstance(operand, int) or (isinstance(operand, float) and operand.is_integer())


def _find(context: Context) -> Iterator[Problem]:
    for item in assignments(context):
        if not item.known or item.scope is None or not isinstance(item.operand, Calculation):
            continue
        if item.operator.params.model_fields[item.parameter].annotation is int and not _whole(item.scope, item.operand):
            message = f"'{item.parameter}' of '{item.operator.name}' is a whole number, the formula may give another"
            yield item.problem("not-whole", message, "wrap the formula in `round`")


CHECK = Check(
    "not-whole",
    "warning",
    "A formula for a parameter that is a whole number may give a fraction.",
    "The operator refuses a fraction; which way to round is for the author to say.",
    "Wrap the formula in `round`, `floor` or `ceil`.",
    _find,
)
