"""What the checks of one rule know, and how they walk through its conditions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from expert.facts import FieldInfo, Vocabulary
from expert.rules.layers import Merged, Origin
from expert.rules.model import AnyOf, Calculation, Comparison, Condition, Exists, FieldRef, ForAll, Not, Rule, Threshold
from expert.rules.problem import Problem, suggest
from expert.rules.reader import Path
from expert.rules.shape import place_of
from modules.operator import Operator
from modules.probe import Probe


@dataclass(frozen=True)
class Context:
    """What a rule base is checked against."""

    merged: Merged
    vocabulary: Vocabulary
    operators: Mapping[str, Operator]
    probes: Mapping[str, Probe]

    def threshold(self, name: str) -> Threshold | None:
        """Return a declared threshold."""
        found = self.merged.thresholds.get(name)
        return found[0] if found else None


def each(value: Condition | list[Condition], path: Path) -> Iterator[tuple[Condition, Path]]:
    """Yield a condition, or each one of a list, with its path."""
    if isinstance(value, list):
        for index, item in enumerate(value):
            yield item, (*path, index)
    else:
        yield value, path


def children(condition: Condition, path: Path) -> Iterator[tuple[Condition, Path]]:
    """Yield the conditions directly inside one."""
    if isinstance(condition, Not):
        yield from each(condition.not_, (*path, "not"))
    elif isinstance(condition, Exists):
        yield from each(condition.exists, (*path, "exists"))
    elif isinstance(condition, AnyOf):
        for index, branch in enumerate(condition.any_of):
            yield from each(branch, (*path, "any_of", index))
    elif isinstance(condition, ForAll):
        yield from each(condition.for_all.where, (*path, "for_all", "where"))
        yield from each(condition.for_all.then, (*path, "for_all", "then"))


def walk(rule: Rule) -> Iterator[tuple[Condition, Path, int]]:
    """Yield every condition of a rule with its path and depth; top-level ones have depth 0."""
    stack: list[tuple[Condition, Path, int]] = [
        (condition, ("when", index), 0) for index, condition in reversed(list(enumerate(rule.when)))
    ]
    while stack:
        condition, path, depth = stack.pop()
        yield condition, path, depth
        inner = [(child, where, depth + 1) for child, where in children(condition, path)]
        stack.extend(reversed(inner))


@dataclass
class RuleScope:
    """One rule under check.

    `bound` maps the aliases that the rule's top level binds to their templates, `inner` those that exist only inside
    `not`, `any_of`, `exists` and `for_all`.
    """

    context: Context
    rule: Rule
    origin: Origin
    bound: dict[str, str] = field(default_factory=dict)
    inner: dict[str, str] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)

    @classmethod
    def of(cls, context: Context, rule: Rule, origin: Origin) -> RuleScope:
        """Build the scope of a rule and note aliases that mean two templates."""
        scope = cls(context, rule, origin)
        for condition, path, depth in walk(rule):
            if not isinstance(condition, Comparison):
                continue
            known = scope.bound.get(condition.name)
            if known is not None and known != condition.fact:
                message = f"alias '{condition.name}' means '{known}' and '{condition.fact}'"
                scope.complain(path, "alias-conflict", message, "use another alias")
            (scope.bound if depth == 0 else scope.inner).setdefault(condition.name, condition.fact)
        return scope

    def complain(self, path: Path, code: str, message: str, hint: str = "") -> None:
        """Note a problem at a path inside the rule."""
        text = f"rule {self.rule.id}{place_of(path)}: {message}"
        self.problems.append(self.origin.problem(path, code, text, hint))

    def template_of(self, alias: str, *, inside: bool) -> str | None:
        """Return the template an alias stands for."""
        return self.bound.get(alias) or (self.inner.get(alias) if inside else None)

    def field_of(self, reference: FieldRef, *, inside: bool = True) -> FieldInfo | None:
        """Return what the vocabulary knows of a referenced field."""
        alias, name = reference.field.split(".")
        template = self.context.vocabulary.get(self.template_of(alias, inside=inside) or "")
        return template.fields.get(name) if template else None

    def check_field_ref(self, reference: FieldRef, path: Path, *, inside: bool) -> None:
        """Complain about a reference to an unknown alias or field."""
        alias, name = reference.field.split(".")
        template = self.template_of(alias, inside=inside)
        if template is None:
            known = set(self.bound) | (set(self.inner) if inside else set())
            message = f"nothing is called '{alias}' here"
            self.complain(path, "unknown-alias", message, suggest(alias, known) or "bind it with `as:` in a condition")
            return
        info = self.context.vocabulary.get(template)
        if info is not None and name not in info.fields:
            message = f"fact '{template}' has no field '{name}'"
            self.complain(path, "unknown-field", message, suggest(name, info.fields))

    def check_threshold(self, name: str, path: Path) -> None:
        """Complain about a threshold that is not declared."""
        known = self.context.merged.named_thresholds
        if name not in known:
            hint = suggest(name, known) or "declare it under `thresholds`"
            self.complain(path, "undefined-threshold", f"threshold '{name}' is not declared", hint)

    def check_operand(self, operand: Any, path: Path, *, inside: bool) -> None:
        """Complain about unknown names and malformed arithmetic in an operand."""
        if isinstance(operand, FieldRef):
            self.check_field_ref(operand, (*path, "field"), inside=inside)
        elif isinstance(operand, Calculation):
            names = sorted(operand.model_fields_set)
            if len(names) != 1 or getattr(operand, names[0]) is None:
                message = f"a calculation needs exactly one operation, not {', '.join(names) or 'none'}"
                self.complain(path, "bad-calculation", message, "nest calculations to combine operations")
                return
            name, operands = operand.operation()
            is_list = isinstance(getattr(operand, name), list)
            for index, item in enumerate(operands):
                inner: Path = (*path, name, index) if is_list else (*path, name)
                if isinstance(item, str):
                    self.complain(inner, "wrong-type", f"{name} cannot calculate with text '{item}'", "use a number")
                self.check_operand(item, inner, inside=inside)
        elif hasattr(operand, "threshold"):
            self.check_threshold(operand.threshold, (*path, "threshold"))
