"""`impossible-condition`: conditions that can never hold together."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, RuleScope
from expert.rules.checks.logic import Conjunction, groups
from expert.rules.explain import condition_text
from expert.rules.problem import Problem
from expert.rules.reader import Path


def _text(scope: RuleScope, conjunction: Conjunction, path: Path) -> str:
    condition = next(item for item, where in conjunction.conditions if where == path)
    thresholds = {name: item for name, (item, _) in scope.context.merged.thresholds.items()}
    return condition_text(condition, scope.context.vocabulary, thresholds)


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for where, conditions in groups(scope):
            conjunction = Conjunction.of(scope, conditions)
            if conjunction.clash is None:
                continue
            first, second = conjunction.clash
            text = _text(scope, conjunction, second)
            if first == second:
                message = f"it can never be that {text}: the field has no such value"
            else:
                message = f"it can never be that {_text(scope, conjunction, first)} and {text}"
            negated = "not" in where
            hint = "the negation is always true; remove or correct it" if negated else "correct one of the limits"
            yield scope.problem(second, "impossible-condition", message, hint)


CHECK = Check(
    "impossible-condition",
    "warning",
    "Conditions that have to hold together exclude each other, or one of them allows no value of its field.",
    "The rule, or the branch of it, never fires, and nobody notices.",
    "Correct one of the limits, or write the two as branches of `any_of`.",
    _find,
)
