"""`underived-finding`: a finding that rules ask for and none derives."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, asked_by, derived_by
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    derived = {name for scope in context.scopes for name in derived_by(scope.rule)}
    asked = {name for scope in context.scopes for name in asked_by(scope.rule)}
    for name, (_, origin) in context.merged.findings.items():
        if name in asked and name not in derived:
            text = f"finding '{name}' is asked for, but no rule derives it"
            yield origin.problem((), "underived-finding", text, "write a rule that derives it")


CHECK = Check(
    "underived-finding",
    "warning",
    "Rules ask for a finding that no rule derives.",
    "They never fire, or always, where they ask for its absence.",
    "Write the rule that derives it, or remove what asks for it.",
    _find,
)
