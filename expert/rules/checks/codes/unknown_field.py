"""`unknown-field`: a field that its fact does not have."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.model import FieldRef
from expert.rules.problem import Problem, suggest


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        named = [
            (item.fact, item.field, (*path, "field")) for item, path in scope.comparisons if item.field is not None
        ]
        for use in scope.operands:
            if isinstance(use.operand, FieldRef):
                alias, name = use.operand.field.split(".")
                named.append((scope.template_of(alias, inside=use.inside) or "", name, (*use.path, "field")))
        for fact, name, path in named:
            template = context.vocabulary.get(fact)
            if template is not None and name not in template.fields:
                message = f"fact '{fact}' has no field '{name}'"
                yield scope.problem(path, "unknown-field", message, suggest(name, template.fields))


CHECK = Check(
    "unknown-field",
    "error",
    "A condition or a formula names a field that its fact does not have.",
    "A comparison with a field that does not exist is false for ever.",
    "Write the name that is suggested, or look it up in the reference of facts.",
    _find,
)
