"""`alias-conflict`: one name for two kinds of facts."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        first: dict[str, str] = {}
        for condition, path in scope.comparisons:
            known = scope.bound.get(condition.name) or first.setdefault(condition.name, condition.fact)
            if known != condition.fact:
                message = f"alias '{condition.name}' means '{known}' and '{condition.fact}'"
                yield scope.problem(path, "alias-conflict", message, "use another alias")


CHECK = Check(
    "alias-conflict",
    "error",
    "One alias stands for two kinds of facts.",
    "Conditions with one alias speak of one fact; a fact of two kinds does not exist, and the rule would never fire.",
    "Give one of the two another name with `as:`.",
    _find,
)
