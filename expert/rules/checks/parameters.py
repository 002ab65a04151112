"""What is known of the parameters of operators, and which values a formula can take."""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from expert.rules.checks.context import Context, RuleScope, one_operation
from expert.rules.layers import Origin
from expert.rules.model import Calculation, Choose, FieldRef, Quantity, Repair, Set, ThresholdRef
from expert.rules.problem import Problem
from expert.rules.reader import Path
from modules.operator import Operator, OperatorParams

Interval = tuple[float, float]
_EVERYTHING: Interval = (-math.inf, math.inf)


@dataclass(frozen=True)
class Assignment:
    """A parameter that a rule or a slot gives an operator, where it is written and who speaks.

    `scope` is None for the default of a slot, whose values are plain.
    """

    operator: Operator
    parameter: str
    operand: Any
    path: Path
    name_path: Path
    scope: RuleScope | None
    origin: Origin
    slot: str = ""

    @property
    def known(self) -> bool:
        """Whether the operator has such a parameter."""
        return self.parameter in self.operator.params.model_fields

    @property
    def label(self) -> str:
        """The parameter in words."""
        return f"parameter '{self.parameter}' of '{self.operator.name}'"

    def problem(self, code: str, message: str, hint: str, *, at_name: bool = False) -> Problem:
        """Return a problem at the value, or at the name of the parameter."""
        path = self.name_path if at_name else self.path
        if self.scope is not None:
            return self.scope.problem(path, code, message, hint)
        return self.origin.problem(path, code, f"slot {self.slot}: {message}", hint)


def assignments(context: Context) -> Iterator[Assignment]:
    """Yield every parameter that rules and slots give to operators that exist."""
    for scope in context.scopes:
        for action, path in scope.actions:
            if isinstance(action, Choose | Repair):
                name = action.choose if isinstance(action, Choose) else action.repair
                operator = context.operators.get(name)
                for parameter, operand in action.with_.items() if operator else ():
                    where = (*path, "with", parameter)
                    yield Assignment(
                        typing.cast(Operator, operator), parameter, operand, where, where, scope, scope.origin
                    )
            elif isinstance(action, Set) and action.set in context.operators:
                operator = context.operators[action.set]
                yield Assignment(
                    operator, action.parameter, action.to, (*path, "to"), (*path, "parameter"), scope, scope.origin
                )
    for slot, origin in context.merged.slots.values():
        operator = context.operators.get(slot.default)
        for parameter, value in slot.with_.items() if operator else ():
            where = ("with", parameter)
            yield Assignment(typing.cast(Operator, operator), parameter, value, where, where, None, origin, slot.slot)


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


def is_numeric(annotation: Any) -> bool:
    """Say whether a parameter is a number."""
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return any(is_numeric(part) for part in typing.get_args(annotation))
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


def interval_of(scope: RuleScope, operand: Any, *, inside: bool = False) -> Interval | None:
    """Return the values an operand can take, or None when it is no number."""
    if isinstance(operand, bool | str):
        return None
    if isinstance(operand, int | float):
        return float(operand), float(operand)
    if isinstance(operand, Quantity):
        return operand.value, operand.value
    if isinstance(operand, ThresholdRef):
        threshold = scope.context.threshold(operand.threshold)
        return (threshold.value, threshold.value) if threshold else _EVERYTHING
    if isinstance(operand, FieldRef):
        info = scope.field_of(operand, inside=inside)
        if info is None:
            return _EVERYTHING
        if info.kind not in ("number", "integer"):
            return None
        return (-math.inf if info.ge is None else info.ge, math.inf if info.le is None else info.le)
    if isinstance(operand, Calculation):
        if not one_operation(operand):
            return _EVERYTHING
        name, operands = operand.operation()
        parts = [interval_of(scope, item, inside=inside) for item in operands]
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


def validation_fault(item: Assignment) -> tuple[str, str] | None:
    """Return code and sentence for a plain value that the model of an operator refuses."""
    try:
        item.operator.params(**{item.parameter: item.operand})
    except ValidationError as error:
        for found in error.errors(include_url=False):
            if found["loc"] and found["loc"][0] == item.parameter:
                return _validation_words(found, item.label)
    return None


def plain(operand: Any) -> bool:
    """Say whether an operand is a literal."""
    return isinstance(operand, bool | int | float | str)
