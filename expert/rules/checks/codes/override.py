"""`override`: a rule or threshold takes the place of one in a lower layer."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.layers import overridden
from expert.rules.model import Threshold
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    for rule, origin, lower, place in overridden(context.merged.layers, lambda layer: layer.rules):
        if rule.name == lower.name:
            message = f"rule {rule.id} takes the place of the one in {place.document.file}"
            yield origin.problem(("id",), "override", message)
    for threshold, origin, below, place in overridden(context.merged.layers, lambda layer: layer.thresholds):
        name, file = origin.path[-1], place.document.file
        message = f"threshold {name} is {_shown(threshold)}, in the place of {_shown(below)} in {file}"
        yield origin.problem((), "override", message)


def _shown(threshold: Threshold) -> str:
    return f"{threshold.value:g}" + (f" {threshold.unit}" if threshold.unit != "1" else "")


CHECK = Check(
    "override",
    "note",
    "A rule of the same id and name, or a threshold of the same name, takes the place of one in a lower layer.",
    "That is how a rig changes shipped rules; the note tells whoever did not know that the name was taken.",
    "Nothing, if it is meant; otherwise choose another id or name.",
    _find,
)
