"""`slot-without-default`: a slot that does not say what fills it when no rule chooses."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    for (stage, name), (slot, origin) in context.merged.slots.items():
        if "default" not in slot.model_fields_set:
            text = f"slot {stage}.{name} does not say what fills it when no rule chooses"
            yield origin.problem((), "slot-without-default", text, "write `default:`, if only `none`")


CHECK = Check(
    "slot-without-default",
    "warning",
    "A slot does not say which operator fills it when no rule chooses one.",
    "That nothing is done is a decision, too, and must be read in the file to be believed.",
    "Write `default:` with an operator, or `none`.",
    _find,
)
