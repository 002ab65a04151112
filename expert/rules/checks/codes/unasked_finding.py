"""`unasked-finding`: a finding that changes nothing."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, asked_by
from expert.rules.model import Derive
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    asked = {name for scope in context.scopes for name in asked_by(scope.rule)}
    everything = any(
        item.fact == "finding"
        and not any(other.fact == "finding" and other.field == "name" for other, _ in scope.comparisons)
        for scope in context.scopes
        for item, _ in scope.comparisons
    )
    derived: dict[str, set[str]] = {}
    for scope in context.scopes:
        for action in scope.rule.then:
            if isinstance(action, Derive):
                derived.setdefault(action.derive, set()).add(action.severity)
    for name, (_, origin) in context.merged.findings.items():
        if name in asked or everything or not derived.get(name) or "critical" in derived[name]:
            continue
        text = f"finding '{name}' is derived, but no rule asks for it, so that it changes no decision"
        hint = "ask for it, or: # terrex: ignore[unasked-finding] what the user does with it"
        yield origin.problem((), "unasked-finding", text, hint)


CHECK = Check(
    "unasked-finding",
    "warning",
    "A rule derives a finding that no rule asks for. Critical findings, which end the reconstruction, and judgements "
    "of products (`assess`) are answers in themselves and not reported.",
    "Either the rule that should use it is missing, or it only informs the user, which somebody should have decided.",
    "Write the rule that asks for it, or say beside its declaration what the user does with it.",
    _find,
)
