"""Ties: rules that may fire together and whose proposals only their ids tell apart."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from expert.rules.checks.context import Context
from expert.rules.layers import Origin
from expert.rules.model import Choose, Comparison, FindingCondition, Not, Rule, Set, ThresholdRef
from expert.rules.problem import Problem
from expert.rules.reader import Path


@dataclass(frozen=True)
class _Proposal:
    target: str
    value: str
    score: float
    rule: Rule
    origin: Origin
    path: Path


def _proposals(context: Context) -> Iterator[_Proposal]:
    for rule, origin in context.merged.rules.values():
        for index, action in enumerate(rule.then):
            if isinstance(action, Choose):
                operator = context.operators.get(action.choose)
                slot = action.slot or (operator.slot if operator else "")
                target = f"slot {rule.stage}.{slot}"
                yield _Proposal(target, action.choose, action.score, rule, origin, ("then", index, "choose"))
            elif isinstance(action, Set):
                target = f"{action.set} {action.parameter}"
                yield _Proposal(target, repr(action.to), action.score, rule, origin, ("then", index, "set"))


def _bounds(condition: Comparison, context: Context) -> tuple[float, float, bool, bool] | None:
    """Return low, high and whether each end belongs to it, where a comparison restricts a number to a range."""
    value: Any = condition.value
    if isinstance(value, ThresholdRef):
        threshold = context.threshold(value.threshold)
        value = threshold.value if threshold else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if condition.op in ("lt", "le"):
        return -math.inf, value, True, condition.op == "le"
    if condition.op in ("gt", "ge"):
        return value, math.inf, condition.op == "ge", True
    return (value, value, True, True) if condition.op == "eq" else None


def _contradict(first: Comparison, second: Comparison, context: Context) -> bool:
    if (first.fact, first.field, first.name) != (second.fact, second.field, second.name) or first.field is None:
        return False
    template = context.vocabulary.get(first.fact)
    if template is None or template.keys or first.alias or second.alias:
        return False
    if {first.op, second.op} == {"present", "absent"}:
        return True
    one, two = _bounds(first, context), _bounds(second, context)
    if one is not None and two is not None:
        low, high = (one, two) if one[0] <= two[0] else (two, one)
        return low[1] < high[0] or (low[1] == high[0] and not (low[3] and high[2]))
    if first.op == second.op == "eq" and isinstance(first.value, bool | str):
        return first.value != second.value
    return False


def _exclusive(first: Rule, second: Rule, context: Context) -> bool:
    """Say whether two rules can be seen never to fire together."""
    for one, two in itertools.product(first.when, second.when):
        if isinstance(one, Comparison) and isinstance(two, Comparison) and _contradict(one, two, context):
            return True
        for plain, negated in ((one, two), (two, one)):
            if isinstance(negated, Not) and isinstance(plain, Comparison | FindingCondition) and negated.not_ == plain:
                return True
    return False


def tie_warnings(context: Context) -> list[Problem]:
    """Return pairs of rules that propose different things for one place with equal score and priority."""
    problems: list[Problem] = []
    groups: dict[tuple[str, float, int], list[_Proposal]] = {}
    for proposal in _proposals(context):
        groups.setdefault((proposal.target, proposal.score, proposal.rule.priority), []).append(proposal)
    for group in groups.values():
        for one, two in itertools.combinations(sorted(group, key=lambda item: item.rule.id), 2):
            if one.rule.id == two.rule.id or one.value == two.value or _exclusive(one.rule, two.rule, context):
                continue
            message = (
                f"rule {two.rule.id}: proposes {two.value} for {one.target} with the score and priority "
                f"with which {one.rule.id} proposes {one.value}, so that the id decides"
            )
            problems.append(two.origin.problem(two.path, "tie", message, "change a score or a priority"))
    return problems
