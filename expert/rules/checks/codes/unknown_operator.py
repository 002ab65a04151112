"""`unknown-operator`: an operator that is not in the catalog."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, named_operators
from expert.rules.model import Exclude
from expert.rules.problem import Problem, suggest


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for action, path in scope.actions:
            for name, where, _ in named_operators(action, path):
                if name not in context.operators and not (isinstance(action, Exclude) and name in context.probes):
                    hint = suggest(name, context.operators)
                    yield scope.problem(where, "unknown-operator", f"there is no operator '{name}'", hint)
    for slot, origin in context.merged.slots.values():
        if slot.default != "none" and slot.default not in context.operators:
            message = f"slot {slot.slot}: there is no operator '{slot.default}'"
            yield origin.problem(("default",), "unknown-operator", message, suggest(slot.default, context.operators))


CHECK = Check(
    "unknown-operator",
    "error",
    "An action or a slot names an operator that is not in the catalog.",
    "There is nothing to run.",
    "Write the name that is suggested, or look it up in the reference of operators; `none` leaves a slot empty.",
    _find,
)
