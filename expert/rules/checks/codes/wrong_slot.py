"""`wrong-slot`: an operator in a place that is not its own."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.model import Choose, Repair
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for action, path in scope.actions:
            if not isinstance(action, Choose | Repair) or action.slot is None:
                continue
            name = action.choose if isinstance(action, Choose) else action.repair
            operator = context.operators.get(name)
            if operator and action.slot in context.slots_of(operator.stage) and action.slot != operator.slot:
                message = f"'{name}' fills slot '{operator.slot}', not '{action.slot}'"
                yield scope.problem((*path, "slot"), "wrong-slot", message, "remove `slot:`")
    for (stage, name), (slot, origin) in context.merged.slots.items():
        operator = context.operators.get(slot.default)
        if operator is not None and (operator.stage, operator.slot) != (stage, name):
            message = f"slot {stage}.{name}: '{slot.default}' fills {operator.stage}.{operator.slot}"
            yield origin.problem(("default",), "wrong-slot", message, "choose an operator of this slot")


CHECK = Check(
    "wrong-slot",
    "error",
    "An operator is put into a slot that is not the one it fills.",
    "An operator turns the state of its stage into the next one at one place of the order; elsewhere it does harm.",
    "Leave `slot:` out, since an operator knows its slot, or choose an operator of this slot.",
    _find,
)
