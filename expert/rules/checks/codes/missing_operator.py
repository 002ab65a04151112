"""`missing-operator`: a value without a comparison."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for condition, path in scope.comparisons:
            if condition.op in ("present", "absent") and condition.value is not None:
                hint = "remove the value" if "op" in condition.model_fields_set else "add `op:`"
                message = f"a value, but the operator is '{condition.op}'"
                yield scope.problem((*path, "value"), "missing-operator", message, hint)


CHECK = Check(
    "missing-operator",
    "error",
    "A condition has a value, but does not say how to compare with it.",
    "Without `op` a condition only asks that the fact exists, which is seldom what was meant beside a value.",
    "Add `op:` (eq, ne, lt, le, gt, ge, abs_..., between, in, ...), or remove the value.",
    _find,
)
