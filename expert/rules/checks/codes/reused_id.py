"""`reused-id`: a rule of another name takes the place of one in a lower layer."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.layers import overridden
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    for rule, origin, lower, place in overridden(context.merged.layers, lambda layer: layer.rules):
        if rule.name != lower.name:
            message = f"rule {rule.id} {rule.name} takes the place of {lower.name} in {place.document.file}"
            hint = f"give it an id of its own, or the name {lower.name} if that is meant"
            yield origin.problem(("id",), "reused-id", message, hint)


CHECK = Check(
    "reused-id",
    "warning",
    "A rule has the id of a rule in a lower layer, and another name.",
    "The lower one is no longer in force, and nobody may have wanted that: an id was taken that was not free.",
    "Give it an id of its own. If it shall replace the other rule, give it the name of that, too.",
    _find,
)
