"""`duplicate-name`: two rules of one name."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    first: dict[str, str] = {}
    for scope in context.scopes:
        other = first.setdefault(scope.rule.name, scope.rule.id)
        if other != scope.rule.id:
            message = f"the name '{scope.rule.name}' is already that of {other}"
            yield scope.problem(("name",), "duplicate-name", message, "name each rule after its own condition")


CHECK = Check(
    "duplicate-name",
    "warning",
    "Two rules have one name.",
    "Reports and logs show names, and nobody can tell which of the two spoke.",
    "Name each after its own condition; a rule that shall replace another one takes its id.",
    _find,
)
