"""Warnings about declarations that nothing uses, and values that may leave their range."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

from expert.rules.checks.context import Context, RuleScope, walk
from expert.rules.checks.parameters import interval_of, limits_of
from expert.rules.model import (
    Assess,
    Calculation,
    Choose,
    Comparison,
    Derive,
    FieldRef,
    FindingCondition,
    Repair,
    Rule,
    Set,
    ThresholdRef,
)
from expert.rules.problem import Problem
from expert.rules.reader import Path


def _thresholds_in(operand: Any) -> Iterator[str]:
    if isinstance(operand, ThresholdRef):
        yield operand.threshold
    elif isinstance(operand, Calculation) and operand.model_fields_set:
        for item in operand.operation()[1]:
            yield from _thresholds_in(item)
    elif isinstance(operand, list):
        for item in operand:
            yield from _thresholds_in(item)


def _operands(rule: Rule) -> Iterator[Any]:
    for condition, _, _ in walk(rule):
        if isinstance(condition, Comparison):
            yield condition.value
    for action in rule.then:
        if isinstance(action, Choose | Repair):
            yield from action.with_.values()
        elif isinstance(action, Set):
            yield action.to


def rule_thresholds(rule: Rule) -> set[str]:
    """Return the named thresholds that a rule uses."""
    return {name for operand in _operands(rule) for name in _thresholds_in(operand)}


def _derived(rules: Iterable[Rule]) -> set[str]:
    found: set[str] = set()
    for rule in rules:
        found |= {action.derive for action in rule.then if isinstance(action, Derive)}
        found |= {action.assess for action in rule.then if isinstance(action, Assess)}
    return found


def _asked(rules: Iterable[Rule]) -> set[str]:
    found: set[str] = set()
    for rule in rules:
        for condition, _, _ in walk(rule):
            if isinstance(condition, FindingCondition):
                found.add(condition.finding)
            elif isinstance(condition, Comparison) and condition.fact == "finding" and condition.field == "name":
                values = condition.value if isinstance(condition.value, list) else [condition.value]
                found |= {value for value in values if isinstance(value, str)}
    return found


def usage_warnings(context: Context) -> list[Problem]:
    """Return declared findings and thresholds that no rule uses, findings that no rule derives, slots of no say."""
    merged = context.merged
    rules = [rule for rule, _ in merged.rules.values()]
    derived, asked = _derived(rules), _asked(rules)
    thresholds = {name for rule in rules for name in rule_thresholds(rule)}
    problems: list[Problem] = []
    for name, (_, origin) in merged.findings.items():
        if name not in derived and name not in asked:
            text = f"finding '{name}' is declared, but no rule derives it or asks for it"
            problems.append(origin.problem((), "unused-finding", text, "remove it"))
        elif name not in derived:
            text = f"finding '{name}' is asked for, but no rule derives it"
            problems.append(origin.problem((), "underived-finding", text, "write a rule that derives it"))
    for name, (_, origin) in merged.thresholds.items():
        if name not in thresholds:
            problems.append(
                origin.problem((), "unused-threshold", f"no rule uses threshold '{name}'", "remove it or use it")
            )
    for (stage, name), (slot, origin) in merged.slots.items():
        if "default" not in slot.model_fields_set:
            text = f"slot {stage}.{name} does not say what fills it when no rule chooses"
            problems.append(origin.problem((), "slot-without-default", text, "write `default:`, if only `none`"))
    return problems


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
    return isinstance(operand, int) or (isinstance(operand, float) and operand.is_integer())


def _parameter_warnings(scope: RuleScope, name: str, parameter: str, operand: Any, path: Path) -> None:
    operator = scope.context.operators.get(name)
    if (
        operator is None
        or parameter not in operator.params.model_fields
        or isinstance(operand, bool | int | float | str)
    ):
        return
    interval = interval_of(scope, operand)
    if interval is None:
        return
    low, high = limits_of(operator.params, parameter)
    if -math.inf < interval[0] < low or high < interval[1] < math.inf:
        message = (
            f"'{parameter}' of '{name}' may become {interval[0]:g} to {interval[1]:g}, allowed is {low:g} to {high:g}"
        )
        scope.complain(path, "may-exceed", message, "clamp the formula")
    integer = operator.params.model_fields[parameter].annotation is int
    if integer and isinstance(operand, Calculation) and not _whole(scope, operand):
        message = f"'{parameter}' of '{name}' is a whole number, the formula may give another"
        scope.complain(path, "not-whole", message, "wrap the formula in `round`")


def formula_warnings(context: Context) -> list[Problem]:
    """Return computed parameters that may leave their range for some values of the facts.

    An end that is not known, because a field has no declared range, is not reported.
    """
    problems: list[Problem] = []
    for rule, origin in context.merged.rules.values():
        scope = RuleScope.of(context, rule, origin)
        scope.problems.clear()
        for index, action in enumerate(rule.then):
            if isinstance(action, Choose | Repair):
                name = action.choose if isinstance(action, Choose) else action.repair
                for parameter, operand in action.with_.items():
                    _parameter_warnings(scope, name, parameter, operand, ("then", index, "with", parameter))
            elif isinstance(action, Set):
                _parameter_warnings(scope, action.set, action.parameter, action.to, ("then", index, "to"))
        problems += scope.problems
    return problems
