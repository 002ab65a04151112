"""Check parameters of operators: names, literal values against the model, computed ones by interval arithmetic."""

from __future__ import annotations

import math
import types
import typing
from typing import Any

from pydantic import ValidationError

from expert.rules.checks.context import RuleScope
from expert.rules.layers import Origin
from expert.rules.model import Adjust, Calculation, FieldRef, Slot, ThresholdRef
from expert.rules.problem import Problem, suggest
from expert.rules.reader import Path
from modules.operator import Operator, OperatorParams

Interval = tuple[float, float]
_EVERYTHING: Interval = (-math.inf, math.inf)


def limits_of(model: type[OperatorParams], name: str) -> Interval:
    """Return the declared range of a parameter."""
    low, high = _EVERYTHING
    for item in model.model_fields[name].metadata:
        for bound in ("ge", "gt"):
            if getattr(item, bound, None) is not None:
                low = max(low, float(getattr(item, bound)))
        for bound in ("le", "lt"):
            if getattr(item, bound, None) is not None:
                high = min(high, float(getattr(item, bound)))
    return low, high


def _is_numeric(annotation: Any) -> bool:
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return any(_is_numeric(part) for part in typing.get_args(annotation))
    return annotation in (int, float)


def _product(first: float, second: float) -> float:
    return 0.0 if 0.0 in (first, second) else first * second


def _combine(name: str, parts: list[Interval]) -> Interval:
    """Apply one operation to intervals."""
    low, high = parts[0]
    if name == "clamp":
        (value_low, value_high), (floor_low, floor_high), (top_low, top_high) = parts
        return min(max(value_low, floor_low), top_low), min(max(value_high, floor_high), top_high)
    if name in ("round", "floor", "ceil"):
        down = low - 1 if name == "floor" else low - 0.5 if name == "round" else low
        up = high + 1 if name == "ceil" else high + 0.5 if name == "round" else high
        return (math.ceil(down) if math.isfinite(down) else down, math.floor(up) if math.isfinite(up) else up)
    for other_low, other_high in parts[1:]:
        if name == "add":
            low, high = low + other_low, high + other_high
        elif name == "sub":
            low, high = low - other_high, high - other_low
        elif name == "mul":
            ends = [_product(a, b) for a in (low, high) for b in (other_low, other_high)]
            low, high = min(ends), max(ends)
        elif name == "min":
            low, high = min(low, other_low), min(high, other_high)
        elif name == "max":
            low, high = max(low, other_low), max(high, other_high)
        elif other_low > 0 or other_high < 0:
            ends = [a / b for a in (low, high) for b in (other_low, other_high) if not math.isinf(b)]
            ends += [0.0] if math.isinf(other_low) or math.isinf(other_high) else []
            low, high = min(ends), max(ends)
        else:
            return _EVERYTHING
    return low, high


def interval_of(scope: RuleScope, operand: Any) -> Interval | None:
    """Return the values an operand can take, or None when it is no number."""
    if isinstance(operand, bool | str):
        return None
    if isinstance(operand, int | float):
        return float(operand), float(operand)
    if isinstance(operand, ThresholdRef):
        threshold = scope.context.threshold(operand.threshold)
        return (threshold.value, threshold.value) if threshold else _EVERYTHING
    if isinstance(operand, FieldRef):
        info = scope.field_of(operand, inside=False)
        if info is None:
            return _EVERYTHING
        if info.kind not in ("number", "integer"):
            return None
        return (-math.inf if info.ge is None else info.ge, math.inf if info.le is None else info.le)
    if isinstance(operand, Calculation):
        if len(operand.model_fields_set) != 1:
            return _EVERYTHING
        name, operands = operand.operation()
        parts = [interval_of(scope, item) for item in operands]
        known = [part for part in parts if part is not None]
        return _combine(name, known) if len(known) == len(parts) else None
    return None


def _validation_words(error: Any, label: str) -> tuple[str, str]:
    """Return code and sentence for pydantic's complaint about a parameter."""
    kind, context, value = error["type"], error.get("ctx", {}), error["input"]
    if kind in ("greater_than_equal", "greater_than", "less_than_equal", "less_than"):
        word = {"ge": "at least", "gt": "more than", "le": "at most", "lt": "less than"}
        key = next(key for key in word if key in context)
        return "out-of-range", f"{label} is {value!r}, but must be {word[key]} {context[key]}"
    if kind == "literal_error":
        return "out-of-range", f"{label} is {value!r}, but must be one of {context.get('expected')}"
    wanted = {"int": "a whole number", "float": "a number", "bool": "true or false", "string": "text"}
    noun = wanted.get(kind.split("_")[0])
    if noun is not None:
        return "wrong-type", f"{label} is {value!r}, but must be {noun}"
    message = str(error["msg"])
    return "wrong-type", f"{label} is {value!r}: {message[:1].lower()}{message[1:]}"


def validation_faults(operator: Operator, values: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return (parameter, code, sentence) for every literal that the operator's model refuses."""
    known = {name: value for name, value in values.items() if name in operator.params.model_fields}
    try:
        operator.params(**known)
    except ValidationError as error:
        faults: dict[str, tuple[str, str, str]] = {}
        for item in error.errors(include_url=False):
            name = str(item["loc"][0]) if item["loc"] else ""
            if name in known:
                faults.setdefault(name, (name, *_validation_words(item, f"parameter '{name}' of '{operator.name}'")))
        return list(faults.values())
    return []


def check_parameter(
    scope: RuleScope, operator: Operator, name: str, operand: Any, path: Path, name_path: Path | None = None
) -> None:
    """Check one parameter that a rule gives an operator."""
    if name not in operator.params.model_fields:
        message = f"operator '{operator.name}' has no parameter '{name}'"
        scope.complain(name_path or path, "unknown-parameter", message, suggest(name, operator.params.model_fields))
        return
    if isinstance(operand, bool | int | float | str):
        for _, code, message in validation_faults(operator, {name: operand}):
            scope.complain(path, code, message, "correct the value")
        return
    interval = interval_of(scope, operand)
    low, high = limits_of(operator.params, name)
    numeric = _is_numeric(operator.params.model_fields[name].annotation)
    label = f"parameter '{name}' of '{operator.name}'"
    if numeric and interval is None:
        scope.complain(path, "wrong-type", f"{label} is a number, but the value is not", "give it a number")
    elif not numeric and isinstance(operand, Calculation):
        scope.complain(path, "wrong-type", f"{label} is not a number, but the value is calculated", "give it a value")
    elif numeric and interval is not None and (interval[1] < low or interval[0] > high):
        message = f"{label} would be {interval[0]:g} to {interval[1]:g}, but must be {low:g} to {high:g}"
        scope.complain(path, "out-of-range", message, "correct the formula")


def check_adjust(scope: RuleScope, operator: Operator | None, action: Adjust, path: Path) -> None:
    """Check a bounded step of a parameter."""
    if (action.by is None) == (action.times is None):
        scope.complain(path, "missing-key", "an adjustment needs either `by` or `times`", "give one of them")
    if action.at_least is not None and action.at_most is not None and action.at_least > action.at_most:
        message = f"{action.at_least:g} to {action.at_most:g} is an empty range"
        scope.complain((*path, "at_most"), "empty-range", message, "write the smaller value under `at_least`")
    if operator is None:
        return
    if action.parameter not in operator.params.model_fields:
        message = f"operator '{operator.name}' has no parameter '{action.parameter}'"
        hint = suggest(action.parameter, operator.params.model_fields)
        scope.complain((*path, "parameter"), "unknown-parameter", message, hint)
        return
    if not _is_numeric(operator.params.model_fields[action.parameter].annotation):
        message = f"parameter '{action.parameter}' of '{operator.name}' is not a number"
        scope.complain((*path, "parameter"), "wrong-type", message, "repair with another value instead")
        return
    low, high = limits_of(operator.params, action.parameter)
    for key, value in (("at_least", action.at_least), ("at_most", action.at_most)):
        if value is not None and not low <= value <= high:
            message = f"'{key}' is {value:g}, but '{action.parameter}' must be {low:g} to {high:g}"
            scope.complain((*path, key), "out-of-range", message, "correct the limit")


def check_slot_values(operator: Operator, slot: Slot, origin: Origin) -> list[Problem]:
    """Check the parameters of a slot's default."""
    problems: list[Problem] = []
    for name in slot.with_:
        if name not in operator.params.model_fields:
            message = f"slot {slot.slot}: operator '{operator.name}' has no parameter '{name}'"
            hint = suggest(name, operator.params.model_fields)
            problems.append(origin.problem(("with", name), "unknown-parameter", message, hint))
    for name, code, message in validation_faults(operator, dict(slot.with_)):
        text = f"slot {slot.slot}: {message}"
        problems.append(origin.problem(("with", name), code, text, "correct the value"))
    return problems
