"""`missing-key`: something that has to be said is not."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, RuleScope
from expert.rules.model import Adjust, Choose, Comparison, Repair
from expert.rules.problem import Problem
from expert.rules.reader import Path


def _of_comparison(scope: RuleScope, condition: Comparison, path: Path) -> Iterator[Problem]:
    op = condition.op
    if op == "present" or (op == "absent" and condition.field is not None):
        return
    if op == "absent":
        hint = "add `field:`, or use `not: {fact: ...}`"
        yield scope.problem(path, "missing-key", "'absent' needs a field", hint)
    elif condition.field is None:
        yield scope.problem(path, "missing-key", f"'{op}' needs a field", "add `field:`")
    elif condition.value is None:
        yield scope.problem(path, "missing-key", f"'{op}' needs a value", "add `value:`")


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for condition, where in scope.comparisons:
            yield from _of_comparison(scope, condition, where)
        for action, path in scope.actions:
            if isinstance(action, Choose | Repair):
                kind = "choose" if isinstance(action, Choose) else "repair"
                if getattr(action, kind) == "none" and action.slot is None:
                    message = f"`{kind}: none` does not say for which slot"
                    yield scope.problem(path, "missing-key", message, "add `slot:`")
            elif isinstance(action, Adjust) and (action.by is None) == (action.times is None):
                message = "an adjustment needs either `by` or `times`"
                yield scope.problem(path, "missing-key", message, "give one of them")


CHECK = Check(
    "missing-key",
    "error",
    "A key that is needed here is missing.",
    "What it would say cannot be guessed.",
    "Add the key that the message names.",
    _find,
)
