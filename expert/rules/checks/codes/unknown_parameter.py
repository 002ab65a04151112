"""`unknown-parameter`: a parameter that its operator does not have."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.checks.parameters import assignments
from expert.rules.model import Adjust, Choose, Repair
from expert.rules.problem import Problem, suggest


def _find(context: Context) -> Iterator[Problem]:
    for item in assignments(context):
        if not item.known:
            message = f"operator '{item.operator.name}' has no parameter '{item.parameter}'"
            hint = suggest(item.parameter, item.operator.params.model_fields)
            yield item.problem("unknown-parameter", message, hint, at_name=True)
    for scope in context.scopes:
        for action, path in scope.actions:
            if isinstance(action, Choose | Repair) and action.with_:
                if "none" in (getattr(action, "choose", ""), getattr(action, "repair", "")):
                    message = "`none` has no parameters"
                    yield scope.problem((*path, "with"), "unknown-parameter", message, "remove `with`")
            elif isinstance(action, Adjust) and action.adjust in context.operators:
                known = context.operators[action.adjust].params.model_fields
                if action.parameter not in known:
                    message = f"operator '{action.adjust}' has no parameter '{action.parameter}'"
                    where = (*path, "parameter")
                    yield scope.problem(where, "unknown-parameter", message, suggest(action.parameter, known))
    for slot, origin in context.merged.slots.values():
        if slot.default == "none" and slot.with_:
            message = f"slot {slot.slot}: `none` has no parameters"
            yield origin.problem(("with",), "unknown-parameter", message, "remove `with`")


CHECK = Check(
    "unknown-parameter",
    "error",
    "An action or a slot gives an operator a parameter that it does not have.",
    "The operator would refuse to run, on the first pair for which the rule fires.",
    "Write the name that is suggested, or look it up in the reference of operators.",
    _find,
)
