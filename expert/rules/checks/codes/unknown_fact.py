"""`unknown-fact`: a condition on a fact that nothing measures."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.problem import Problem, suggest


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for condition, path in scope.comparisons:
            if condition.fact not in context.vocabulary:
                hint = suggest(condition.fact, context.vocabulary)
                message = f"there is no fact '{condition.fact}'"
                yield scope.problem((*path, "fact"), "unknown-fact", message, hint)


CHECK = Check(
    "unknown-fact",
    "error",
    "A condition names a fact that is not in the vocabulary.",
    "The condition would never hold, and the rule would never fire, without a word.",
    "Write the name that is suggested, or look it up in the reference of facts.",
    _find,
)
