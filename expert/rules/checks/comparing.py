"""What several checks ask about a comparison."""

from __future__ import annotations

from typing import Any

from expert.facts import FieldInfo
from expert.rules.checks.context import RuleScope
from expert.rules.checks.units import same_unit
from expert.rules.model import Comparison, Quantity, Scalar, ThresholdRef

ORDERED = frozenset(
    {"lt", "le", "gt", "ge", "abs_lt", "abs_le", "abs_gt", "abs_ge", "between", "significantly_gt", "significantly_lt"}
)
LISTS = frozenset({"in", "not_in", "between"})
NUMERIC = ("number", "integer")


def is_number(value: object) -> bool:
    """Say whether a value is a number; booleans are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def list_fault(condition: Comparison) -> str:
    """Say what the value of a comparison must be, where it is one value instead of a list or the other way round."""
    op, value = condition.op, condition.value
    if (op in LISTS) != isinstance(value, list):
        return "a list of values" if op in LISTS else "one value"
    if isinstance(value, list) and (not value or (op == "between" and len(value) != 2)):
        return "two values, low and high" if op == "between" else "at least one value"
    return ""


def comparable(scope: RuleScope, condition: Comparison) -> FieldInfo | None:
    """Return the field of a comparison whose form is sound, so that its value is worth a closer look."""
    info = scope.info(condition)
    if info is None or condition.op in ("present", "absent") or condition.value is None or list_fault(condition):
        return None
    if condition.op in ORDERED and info.kind not in NUMERIC:
        return None
    return None if condition.op.startswith("significantly") and info.sigma is None else info


def constant(scope: RuleScope, value: Any) -> Scalar | None:
    """Return a literal, the value of a threshold or of a quantity; None for what depends on facts."""
    if isinstance(value, ThresholdRef):
        threshold = scope.context.threshold(value.threshold)
        return threshold.value if threshold else None
    if isinstance(value, Quantity):
        return value.value
    return value if isinstance(value, bool | int | float | str) else None


def same_unit_as(scope: RuleScope, info: FieldInfo, value: Any) -> bool:
    """Say whether a constant is in the unit of a field, as far as it has one."""
    if isinstance(value, ThresholdRef):
        threshold = scope.context.threshold(value.threshold)
        return threshold is None or same_unit(threshold.unit, info.unit)
    return not isinstance(value, Quantity) or same_unit(value.unit, info.unit)


def fits(info: FieldInfo, value: object) -> bool:
    """Say whether a value is of the kind of a field."""
    if info.kind in NUMERIC:
        return is_number(value)
    return isinstance(value, bool) if info.kind == "boolean" else isinstance(value, str)
