"""`unknown-alias`: a formula speaks of a fact that no condition binds."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.model import FieldRef
from expert.rules.problem import Problem, suggest


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        if scope.rule.id in context.merged.incomplete:  # the condition that binds it may be the faulty one
            continue
        for use in scope.operands:
            if not isinstance(use.operand, FieldRef):
                continue
            alias = use.operand.field.split(".")[0]
            if scope.template_of(alias, inside=use.inside) is None:
                known = set(scope.bound) | (set(scope.inner) if use.inside else set())
                hint = suggest(alias, known) or "bind it with `as:` in a condition"
                yield scope.problem((*use.path, "field"), "unknown-alias", f"nothing is called '{alias}' here", hint)


CHECK = Check(
    "unknown-alias",
    "error",
    "A formula or a join speaks of a fact that no condition of the rule binds.",
    "There is nothing to take the value from, so that the action would be left out or the condition be false.",
    "Add a condition on that fact, with `as:` if it shall have another name than its template.",
    _find,
)
