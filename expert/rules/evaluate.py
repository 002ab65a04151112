"""Evaluation of operands, comparisons and actions on bound facts; no engine in here.

Everything is total: a value that cannot be computed (absent field, unbound alias, division by zero, wrong type, no
finite result) is None, and a comparison with None is false. Booleans are not numbers. A comparison between values of
different kinds is false, `ne` and `not_in` included.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from expert.facts import SEVERITIES, Fact, Scalar, Vocabulary, finite, is_number
from expert.firing import ResolvedAction
from expert.rules.model import (
    Action,
    Assess,
    Calculation,
    Choose,
    Comparison,
    Derive,
    FieldRef,
    FindingCondition,
    Quantity,
    Repair,
    Set,
    Threshold,
    ThresholdRef,
)

Bindings = Mapping[str, Fact]
Thresholds = Mapping[str, Threshold]
Limit = Scalar | tuple[Scalar, ...]
SIGNIFICANT_SIGMAS = 2.0  # two standard uncertainties, about 95 % of a normal distribution

_ABSENT: tuple[None, Any] = (None, None)


def resolve(operand: Any, bindings: Bindings, thresholds: Thresholds) -> Scalar | None:
    """Evaluate one operand.

    Parameters
    ----------
    operand : scalar, FieldRef, ThresholdRef, Quantity or Calculation
        What the rule file says.
    bindings : mapping of str to Fact
        The facts that aliases are bound to.
    thresholds : mapping of str to Threshold
        Thresholds of the rule base.

    Returns
    -------
    scalar or None
        None where it cannot be computed.
    """
    if isinstance(operand, FieldRef):
        alias, _, field = operand.field.partition(".")
        fact = bindings.get(alias)
        return None if fact is None else fact.get(field)
    if isinstance(operand, ThresholdRef):
        threshold = thresholds.get(operand.threshold)
        return None if threshold is None else finite(threshold.value)
    if isinstance(operand, Quantity):
        return finite(operand.value)
    if isinstance(operand, Calculation):
        return _calculate(operand, bindings, thresholds)
    return finite(operand)


def holds(op: str, value: Scalar | None, limit: Limit | None = None, sigma: Scalar | None = None) -> bool:
    """Say whether a comparison holds.

    Parameters
    ----------
    op : str
        Operator of the rule language.
    value : scalar or None
        Left side; None means absent.
    limit : scalar or tuple of scalars, optional
        Right side; `(low, high)`, both inclusive, for `between`, all members for `in` and `not_in`.
    sigma : float, optional
        Standard uncertainty of `value`, for `significantly_gt` and `significantly_lt`.
    """
    if op == "present":
        return value is not None
    if op == "absent":
        return value is None
    if value is None or limit is None:
        return False
    if op in _EQUALITIES:
        return not isinstance(limit, tuple) and _EQUALITIES[op](value, limit)
    if op == "in":
        return isinstance(limit, tuple) and any(_equal(value, member) for member in limit)
    if op == "not_in":
        return isinstance(limit, tuple) and all(_different(value, member) for member in limit)
    if not is_number(value):
        return False
    if op == "between":
        if not isinstance(limit, tuple) or len(limit) != 2 or not all(is_number(end) for end in limit):
            return False
        return bool(limit[0] <= value <= limit[1])  # type: ignore[operator]
    if not is_number(limit):
        return False
    if op in ORDERS:
        return ORDERS[op](value, limit)
    return _significant(op, value, limit, sigma)


class Evaluator:
    """Comparisons and actions of one rule base on bound facts.

    Parameters
    ----------
    vocabulary : mapping of str to TemplateInfo
        Tells which field holds the uncertainty of another.
    thresholds : mapping of str to Threshold
        Thresholds of the rule base.
    """

    def __init__(self, vocabulary: Vocabulary, thresholds: Thresholds) -> None:
        self._vocabulary = vocabulary
        self._thresholds = thresholds

    def sides(self, comparison: Comparison, bindings: Bindings) -> tuple[Scalar | None, Limit | None]:
        """Return both sides of a comparison, None where they cannot be computed."""
        fact = bindings.get(comparison.name)
        if fact is None or fact.template != comparison.fact or comparison.field is None:
            return _ABSENT
        return fact.get(comparison.field), self._limit(comparison.value, bindings)

    def comparison(self, comparison: Comparison, bindings: Bindings) -> bool:
        """Say whether a comparison holds; without a field, whether its alias is bound to a fact of its template."""
        fact = bindings.get(comparison.name)
        if fact is None or fact.template != comparison.fact:
            return False
        if comparison.field is None:
            return comparison.op == "present"
        value, limit = self.sides(comparison, bindings)
        return holds(comparison.op, value, limit, self._sigma(comparison, fact))

    def constant(self, comparison: Comparison) -> Limit | None:
        """Return the right side of a comparison that no fact is needed for; None where one is."""
        return self._limit(comparison.value, {})

    def action(self, index: int, action: Action, bindings: Bindings) -> ResolvedAction | None:
        """Evaluate an action's operands; None when one of them cannot be computed."""
        operands: Mapping[str, Any] = {}
        if isinstance(action, Choose | Repair):
            operands = action.with_
        elif isinstance(action, Set):
            operands = {"to": action.to}
        values = []
        for name, operand in sorted(operands.items()):
            value = resolve(operand, bindings, self._thresholds)
            if value is None:
                return None
            values.append((name, value))
        return ResolvedAction(index, type(action).__name__.lower(), tuple(values))

    def actions(self, actions: Sequence[Action], bindings: Bindings) -> tuple[ResolvedAction, ...]:
        """Evaluate all actions of a rule and leave out those that cannot be computed."""
        resolved = (self.action(index, action, bindings) for index, action in enumerate(actions))
        return tuple(action for action in resolved if action is not None)

    def _limit(self, value: Any, bindings: Bindings) -> Limit | None:
        if not isinstance(value, list | tuple):
            return resolve(value, bindings, self._thresholds)
        members = []
        for item in value:
            member = resolve(item, bindings, self._thresholds)
            if member is None:
                return None
            members.append(member)
        return tuple(members)

    def _sigma(self, comparison: Comparison, fact: Fact) -> Scalar | None:
        if not comparison.op.startswith("significantly"):
            return None
        template = self._vocabulary.get(comparison.fact)
        info = template.fields.get(comparison.field or "") if template else None
        return fact.get(info.sigma) if info and info.sigma else None


def matches_finding(condition: FindingCondition, fact: Fact) -> bool:
    """Say whether a fact is a finding of that name and at least that severity."""
    if fact.template != "finding" or fact.get("name") != condition.finding:
        return False
    severity = fact.get("severity")
    return severity in SEVERITIES and SEVERITIES.index(str(severity)) >= SEVERITIES.index(condition.at_least)


def finding_of(action: Action) -> Fact | None:
    """Return the finding that an action asserts, if it asserts one."""
    if isinstance(action, Derive):
        return Fact.of("finding", name=action.derive, severity=action.severity)
    if isinstance(action, Assess):
        return Fact.of("finding", name=action.assess, severity=action.severity)
    return None


def operand_aliases(operand: Any) -> frozenset[str]:
    """Return the aliases that an operand speaks of."""
    if isinstance(operand, FieldRef):
        return frozenset((operand.field.partition(".")[0],))
    if isinstance(operand, Calculation):
        operand = operand.operation()[1]
    if isinstance(operand, list | tuple):
        return frozenset().union(*(operand_aliases(item) for item in operand))
    return frozenset()


def _equal(left: Any, right: Any) -> bool:
    return _comparable(left, right) and left == right


def _different(left: Any, right: Any) -> bool:
    return _comparable(left, right) and left != right


def _comparable(left: Any, right: Any) -> bool:
    return (is_number(left) and is_number(right)) or type(left) is type(right)


_EQUALITIES: Mapping[str, Callable[[Any, Any], bool]] = {"eq": _equal, "ne": _different}
ORDERS: Mapping[str, Callable[[Any, Any], bool]] = {
    "lt": lambda value, limit: value < limit,
    "le": lambda value, limit: value <= limit,
    "gt": lambda value, limit: value > limit,
    "ge": lambda value, limit: value >= limit,
    "abs_lt": lambda value, limit: abs(value) < limit,
    "abs_le": lambda value, limit: abs(value) <= limit,
    "abs_gt": lambda value, limit: abs(value) > limit,
    "abs_ge": lambda value, limit: abs(value) >= limit,
}


def _significant(op: str, value: Any, limit: Any, sigma: Any) -> bool:
    if not is_number(sigma):
        return False
    margin = SIGNIFICANT_SIGMAS * sigma
    if op == "significantly_gt":
        return bool(value - margin > limit)
    return op == "significantly_lt" and bool(value + margin < limit)


_OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": lambda *numbers: sum(numbers),
    "sub": lambda left, right: left - right,
    "mul": lambda *numbers: math.prod(numbers),
    "div": lambda left, right: left / right,
    "min": min,
    "max": max,
    "clamp": lambda value, low, high: min(max(value, low), high),
    "round": round,
    "floor": math.floor,
    "ceil": math.ceil,
}


def _calculate(calculation: Calculation, bindings: Bindings, thresholds: Thresholds) -> Scalar | None:
    if not calculation.model_fields_set:
        return None
    name, operands = calculation.operation()
    numbers = [resolve(operand, bindings, thresholds) for operand in operands]
    if not all(is_number(number) for number in numbers):
        return None
    try:
        result = _OPERATIONS[name](*numbers)
        return result if math.isfinite(result) else None
    except (ZeroDivisionError, OverflowError):
        return None
