"""`unknown-slot`: a place of the plan that its stage does not have."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.model import Choose, Repair
from expert.rules.problem import Problem, suggest


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for action, path in scope.actions:
            if not isinstance(action, Choose | Repair):
                continue
            kind = "choose" if isinstance(action, Choose) else "repair"
            operator = context.operators.get(getattr(action, kind))
            slots = context.slots_of(operator.stage if operator else scope.rule.stage)
            if operator is not None and action.slot is None and operator.slot not in slots:
                message = (
                    f"'{operator.name}' fills slot '{operator.slot}', which stage {operator.stage} does not declare"
                )
                yield scope.problem((*path, kind), "unknown-slot", message, "declare the slot under `slots`")
            if action.slot is not None and action.slot not in slots:
                message = f"there is no slot '{action.slot}'"
                yield scope.problem((*path, "slot"), "unknown-slot", message, suggest(action.slot, slots))


CHECK = Check(
    "unknown-slot",
    "error",
    "An action fills a slot that the stage does not declare.",
    "The plan has no such place, so that the choice would be lost.",
    "Declare the slot under `slots`, with its default, or name one that exists.",
    _find,
)
