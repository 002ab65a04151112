"""`undeclared-finding`: a finding without a sentence for the user."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.model import Assess, Derive, FindingCondition
from expert.rules.problem import Problem, suggest


def _find(context: Context) -> Iterator[Problem]:
    known = context.merged.named_findings
    for scope in context.scopes:
        named = [
            (item.finding, (*path, "finding"))
            for item, path, _ in scope.conditions
            if isinstance(item, FindingCondition)
        ]
        for action, path in scope.actions:
            if isinstance(action, Derive):
                named.append((action.derive, (*path, "derive")))
            elif isinstance(action, Assess):
                named.append((action.assess, (*path, "assess")))
        for name, path in named:
            if name not in known:
                hint = suggest(name, known) or "declare it under `findings`"
                yield scope.problem(path, "undeclared-finding", f"finding '{name}' is not declared", hint)


CHECK = Check(
    "undeclared-finding",
    "error",
    "A rule derives or asks for a finding that no file declares.",
    "A finding is told to the user in the sentence that declares it; a misspelt one would never be found.",
    "Declare it under `findings` with the sentence that the user shall read.",
    _find,
)
