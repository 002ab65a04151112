"""`subsumed-rule`: a rule that adds nothing to another one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from expert.facts import SEVERITIES
from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, RuleScope
from expert.rules.checks.logic import of_rule
from expert.rules.model import Action, Assess, Choose, Derive, Repair, Set
from expert.rules.problem import Problem


def _target(action: Action) -> Any:
    """Return what an action does, without how strongly."""
    return type(action), action.model_dump(exclude={"score", "severity"})


def _covers(action: Action, other: Action) -> bool:
    """Say whether an action does all that another one does, at least as strongly."""
    if _target(action) != _target(other):
        return False
    if isinstance(action, Choose | Repair | Set) and isinstance(other, Choose | Repair | Set):
        return action.score >= other.score
    if isinstance(action, Derive | Assess) and isinstance(other, Derive | Assess):
        return SEVERITIES.index(action.severity) >= SEVERITIES.index(other.severity)
    return True


def _key(scope: RuleScope, action: Action) -> str:
    return f"{scope.rule.stage} {_target(action)}"


def _find(context: Context) -> Iterator[Problem]:
    users: dict[str, list[RuleScope]] = {}
    for scope in context.scopes:
        for key in {_key(scope, action) for action in scope.rule.then}:
            users.setdefault(key, []).append(scope)
    for scope in context.scopes:
        mine = of_rule(scope)
        if mine.clash is not None:
            continue
        for other in users[_key(scope, scope.rule.then[0])]:
            if other.rule.id == scope.rule.id or other.rule.priority < scope.rule.priority:
                continue
            covered = all(any(_covers(its, action) for its in other.rule.then) for action in scope.rule.then)
            if not covered or not mine.implies(of_rule(other)):
                continue
            if of_rule(other).implies(mine) and other.rule.id > scope.rule.id and _equal(scope, other):
                continue  # of two equal rules the later one is reported
            message = f"adds nothing: whenever it fires, {other.rule.id} fires and does the same"
            yield scope.problem((), "subsumed-rule", message, f"remove it, or make {other.rule.id} stricter")
            break


def _equal(one: RuleScope, two: RuleScope) -> bool:
    return one.rule.priority == two.rule.priority and all(
        any(_covers(action, its) for action in one.rule.then) for its in two.rule.then
    )


CHECK = Check(
    "subsumed-rule",
    "warning",
    "Whenever a rule fires, another one fires too and does the same, at least as strongly.",
    "Somebody will change one of the two and wonder why nothing happens.",
    "Remove it, or make the more general rule stricter.",
    _find,
)
