"""`undefined-threshold`: a threshold that is not declared."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.model import ThresholdRef
from expert.rules.problem import Problem, suggest


def _find(context: Context) -> Iterator[Problem]:
    known = context.merged.named_thresholds
    for scope in context.scopes:
        for use in scope.operands:
            if isinstance(use.operand, ThresholdRef) and use.operand.threshold not in known:
                name = use.operand.threshold
                hint = suggest(name, known) or "declare it under `thresholds`"
                path = (*use.path, "threshold")
                yield scope.problem(path, "undefined-threshold", f"threshold '{name}' is not declared", hint)


CHECK = Check(
    "undefined-threshold",
    "error",
    "A rule uses a named threshold that no file declares.",
    "There is no number to compare with.",
    "Declare it under `thresholds`, with its value, its unit and the reason for it.",
    _find,
)
