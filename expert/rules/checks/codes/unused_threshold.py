"""`unused-threshold`: a threshold that no rule uses."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, thresholds_in
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    used = {name for scope in context.scopes for name in thresholds_in(scope.rule)}
    for name, (_, origin) in context.merged.thresholds.items():
        if name not in used:
            yield origin.problem((), "unused-threshold", f"no rule uses threshold '{name}'", "remove it or use it")


CHECK = Check(
    "unused-threshold",
    "warning",
    "A threshold is declared and no rule uses it.",
    "Somebody will move it and see nothing change.",
    "Remove it, or use it where its number is written by hand.",
    _find,
)
