"""`unknown-probe`: a measurement that nobody can make."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.model import Measure
from expert.rules.problem import Problem, suggest


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for action, path in scope.actions:
            if isinstance(action, Measure) and action.measure not in context.probes:
                hint = suggest(action.measure, context.probes)
                message = f"there is no probe '{action.measure}'"
                yield scope.problem((*path, "measure"), "unknown-probe", message, hint)


CHECK = Check(
    "unknown-probe",
    "error",
    "A rule asks to measure with a probe that does not exist.",
    "The facts it waits for would never come.",
    "Write the name that is suggested, or look up in the reference of facts which probe measures what you need.",
    _find,
)
