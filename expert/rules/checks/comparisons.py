"""Check one comparison: does the field exist, and can the value be compared with it."""

from __future__ import annotations

from typing import Any

from expert.facts import FieldInfo
from expert.rules.checks.context import RuleScope
from expert.rules.model import Comparison, FieldRef, ThresholdRef
from expert.rules.problem import suggest
from expert.rules.reader import Path

_ORDERED = frozenset(
    {"lt", "le", "gt", "ge", "abs_lt", "abs_le", "abs_gt", "abs_ge", "between", "significantly_gt", "significantly_lt"}
)
_LISTS = frozenset({"in", "not_in", "between"})


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _fits(info: FieldInfo, value: object) -> bool:
    if info.kind in ("number", "integer"):
        return _number(value)
    return isinstance(value, bool) if info.kind == "boolean" else isinstance(value, str)


def _range_text(info: FieldInfo) -> str:
    low = "" if info.ge is None else f"{info.ge:g}"
    high = "" if info.le is None else f"{info.le:g}"
    unit = "" if info.unit == "1" else f" {info.unit}"
    return f"{low or 'any'} to {high or 'any'}{unit}"


def _check_scalar(scope: RuleScope, info: FieldInfo, op: str, value: Any, path: Path) -> None:
    """Check a literal or a threshold's value against the field it is compared with."""
    if not _fits(info, value):
        wanted = {"text": "text", "boolean": "true or false"}.get(info.kind, "a number")
        message = f"'{info.name}' is {wanted}, but is compared with {value!r}"
        scope.complain(path, "wrong-type", message, f"write {wanted}")
    elif isinstance(value, str):
        if info.choices and value not in info.choices:
            message = f"'{info.name}' is never {value!r}"
            scope.complain(path, "out-of-range", message, suggest(value, info.choices))
    elif info.kind in ("number", "integer"):
        low, high = info.ge, info.le
        if op.startswith("abs_"):
            ends = [abs(end) for end in (low, high) if end is not None]
            low, high = 0.0, max(ends) if len(ends) == 2 else None
        if (low is not None and value < low) or (high is not None and value > high):
            message = f"value {value:g} is outside the range of '{info.name}', {_range_text(info)}"
            scope.complain(path, "out-of-range", message, "correct the value")


def _check_against_field(scope: RuleScope, info: FieldInfo, op: str, value: Any, path: Path) -> None:
    """Check one operand against the field it is compared with: type, range, unit."""
    if isinstance(value, ThresholdRef):
        threshold = scope.context.threshold(value.threshold)
        if threshold is None:
            return
        if threshold.unit != info.unit and info.kind in ("number", "integer"):
            message = f"threshold '{value.threshold}' is in {threshold.unit}, '{info.name}' in {info.unit}"
            scope.complain(path, "wrong-unit", message, "compare quantities of one unit")
        else:
            _check_scalar(scope, info, op, threshold.value, path)
    elif isinstance(value, FieldRef):
        other = scope.field_of(value)
        if other is None:
            return
        numeric = ("number", "integer")
        if (info.kind in numeric) != (other.kind in numeric) or (info.kind not in numeric and info.kind != other.kind):
            message = f"'{info.name}' is a {info.kind}, '{value.field}' a {other.kind}"
            scope.complain(path, "wrong-type", message, "compare fields of one kind")
        elif other.unit != info.unit:
            message = f"'{info.name}' is in {info.unit}, '{value.field}' in {other.unit}"
            scope.complain(path, "wrong-unit", message, "compare quantities of one unit")
    elif isinstance(value, bool | int | float | str):
        _check_scalar(scope, info, op, value, path)
    elif info.kind not in ("number", "integer"):
        scope.complain(path, "wrong-type", f"'{info.name}' is {info.kind}, not a number", "compare it with a value")


def _check_form(scope: RuleScope, condition: Comparison, path: Path) -> bool:
    """Check that operator and value go together; return whether the value is worth a closer look."""
    op, value = condition.op, condition.value
    written = "op" in condition.model_fields_set
    if op in ("present", "absent"):
        if value is not None:
            hint = "remove the value" if written else "add `op:`"
            scope.complain((*path, "value"), "missing-operator", f"a value, but the operator is '{op}'", hint)
        if op == "absent" and condition.field is None:
            scope.complain(path, "missing-key", "'absent' needs a field", "add `field:`, or use `not: {fact: ...}`")
        return False
    if condition.field is None:
        scope.complain(path, "missing-key", f"'{op}' needs a field", "add `field:`")
        return False
    if value is None:
        scope.complain(path, "missing-key", f"'{op}' needs a value", "add `value:`")
        return False
    if (op in _LISTS) != isinstance(value, list):
        wanted = "a list of values" if op in _LISTS else "one value"
        scope.complain((*path, "value"), "wrong-type", f"'{op}' needs {wanted}", "correct the value")
        return False
    if isinstance(value, list) and (not value or (op == "between" and len(value) != 2)):
        wanted = "two values, low and high" if op == "between" else "at least one value"
        scope.complain((*path, "value"), "wrong-type", f"'{op}' needs {wanted}", "correct the list")
        return False
    return True


def _check_between(scope: RuleScope, values: list[Any], path: Path) -> None:
    numbers: list[float] = []
    for value in values:
        threshold = scope.context.threshold(value.threshold) if isinstance(value, ThresholdRef) else None
        numbers += [threshold.value] if threshold else [value] if _number(value) else []
    if len(numbers) == 2 and numbers[0] > numbers[1]:
        message = f"{numbers[0]:g} to {numbers[1]:g} is an empty range"
        scope.complain(path, "empty-range", message, "write the smaller value first")


def check_comparison(scope: RuleScope, condition: Comparison, path: Path, *, inside: bool) -> None:
    """Check a comparison's fact, field, operator, value and unit."""
    template = scope.context.vocabulary.get(condition.fact)
    usable = _check_form(scope, condition, path)
    values = condition.value if isinstance(condition.value, list) else [condition.value]
    paths: list[Path] = [(*path, "value", index) for index in range(len(values))]
    if not isinstance(condition.value, list):
        paths = [(*path, "value")]
    for value, where in zip(values, paths, strict=True):
        scope.check_operand(value, where, inside=True)
    if template is None:
        hint = suggest(condition.fact, scope.context.vocabulary)
        scope.complain((*path, "fact"), "unknown-fact", f"there is no fact '{condition.fact}'", hint)
        return
    if condition.field is None:
        return
    info = template.fields.get(condition.field)
    if info is None:
        message = f"fact '{condition.fact}' has no field '{condition.field}'"
        scope.complain((*path, "field"), "unknown-field", message, suggest(condition.field, template.fields))
        return
    if condition.unit is not None and condition.unit != info.unit:
        message = f"'{info.name}' is in {info.unit}, not in {condition.unit}"
        scope.complain((*path, "unit"), "wrong-unit", message, "convert the value")
    if condition.op in _ORDERED and info.kind not in ("number", "integer"):
        message = f"'{condition.op}' compares numbers, but '{info.name}' is {info.kind}"
        scope.complain((*path, "op"), "wrong-type", message, "use eq, ne, in or not_in")
        return
    if condition.op.startswith("significantly") and info.sigma is None:
        message = f"'{info.name}' has no uncertainty, so '{condition.op}' cannot be decided"
        scope.complain((*path, "op"), "wrong-type", message, "use gt or lt")
    if usable:
        for value, where in zip(values, paths, strict=True):
            _check_against_field(scope, info, condition.op, value, where)
        if condition.op == "between":
            _check_between(scope, values, (*path, "value"))
