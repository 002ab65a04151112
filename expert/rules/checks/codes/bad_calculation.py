"""`bad-calculation`: none or several operations in one calculation."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, one_operation
from expert.rules.model import Calculation
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for use in scope.operands:
            if isinstance(use.operand, Calculation) and not one_operation(use.operand):
                names = ", ".join(sorted(use.operand.model_fields_set)) or "none"
                message = f"a calculation needs exactly one operation, not {names}"
                yield scope.problem(use.path, "bad-calculation", message, "nest calculations to combine operations")


CHECK = Check(
    "bad-calculation",
    "error",
    "A calculation names no operation, or several at once.",
    "In which order they were meant cannot be seen.",
    "Write one of add, sub, mul, div, min, max, clamp, round, floor, ceil, and nest another inside it.",
    _find,
)
