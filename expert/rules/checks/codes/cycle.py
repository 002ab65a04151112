"""`cycle`: rules that wait for each other's findings through a negation."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.model import STAGES
from expert.rules.problem import Problem
from expert.rules.strata import CyclicNegation, stratify


def _find(context: Context) -> Iterator[Problem]:
    for stage in STAGES:
        try:
            stratify(rule for rule, _ in context.merged.rules.values() if rule.stage == stage)
        except CyclicNegation as error:
            sentence, _, hint = str(error).partition("; ")
            yield context.merged.rules[error.rules[0]][1].problem((), "cycle", sentence, hint)


CHECK = Check(
    "cycle",
    "error",
    "Rules depend on each other's findings in a circle that leads through `not` or `for_all`.",
    "Whether a finding is absent can only be said once every rule that may derive it has had its turn.",
    "Derive the finding without asking for its own absence, or split the rule.",
    _find,
)
