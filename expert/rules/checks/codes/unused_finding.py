"""`unused-finding`: a finding that is declared and never derived or asked for."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, asked_by, derived_by
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    used = {name for scope in context.scopes for name in {*derived_by(scope.rule), *asked_by(scope.rule)}}
    for name, (_, origin) in context.merged.findings.items():
        if name not in used:
            text = f"finding '{name}' is declared, but no rule derives it or asks for it"
            yield origin.problem((), "unused-finding", text, "remove it")


CHECK = Check(
    "unused-finding",
    "warning",
    "A finding is declared, but no rule derives it or asks for it.",
    "Readers take the list of findings for what the system can say.",
    "Remove it, or write the rule that derives it.",
    _find,
)
