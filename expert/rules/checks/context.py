"""What the checks of one rule know, and how they walk through its conditions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from expert.facts import SEVERITIES, Fact, FieldInfo, Vocabulary
from expert.rules.layers import Merged, Origin
from expert.rules.model import (
    Action,
    Adjust,
    AnyOf,
    Assess,
    Calculation,
    Choose,
    Comparison,
    Condition,
    Derive,
    Exclude,
    Exists,
    FieldRef,
    FindingCondition,
    ForAll,
    Not,
    Repair,
    Rule,
    Set,
    Threshold,
    ThresholdRef,
)
from expert.rules.problem import Problem
from expert.rules.reader import Path
from expert.rules.shape import place_of
from modules.operator import Operator
from modules.probe import Probe

if TYPE_CHECKING:
    from expert.rules.checks.logic import Conjunction


@dataclass(frozen=True)
class GivenCase:
    """What the checks look at in a case: the facts, and whether the rule has to fire."""

    facts: frozenset[Fact]
    fires: bool


@dataclass(frozen=True)
class Context:
    """What a rule base is checked against.

    `cases` holds the cases of each rule; None where nobody asks for cases. `case_folder` is where they lie;
    None where nobody said.
    """

    merged: Merged
    vocabulary: Vocabulary
    operators: Mapping[str, Operator]
    probes: Mapping[str, Probe]
    cases: Mapping[str, Sequence[GivenCase]] | None = None
    case_folder: str | None = "knowledge/cases"

    @cached_property
    def scopes(self) -> tuple[RuleScope, ...]:
        """The rules, each with its aliases."""
        return tuple(RuleScope.of(self, rule, origin) for rule, origin in self.merged.rules.values())

    def threshold(self, name: str) -> Threshold | None:
        """Return a declared threshold."""
        found = self.merged.thresholds.get(name)
        return found[0] if found else None

    def slots_of(self, stage: str) -> set[str]:
        """Return the slots that a stage declares."""
        return {slot for its, slot in self.merged.named_slots if its == stage}


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


@dataclass(frozen=True)
class Use:
    """An operand where it is written; `inside` says whether it may speak of aliases of `not`, `any_of` and the like."""

    operand: Any
    path: Path
    inside: bool


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
    reading: Conjunction | None = None  # of its conditions, made when first asked for

    @classmethod
    def of(cls, context: Context, rule: Rule, origin: Origin) -> RuleScope:
        """Build the scope of a rule."""
        scope = cls(context, rule, origin)
        for condition, _, depth in scope.conditions:
            if isinstance(condition, Comparison):
                (scope.bound if depth == 0 else scope.inner).setdefault(condition.name, condition.fact)
        return scope

    @cached_property
    def conditions(self) -> tuple[tuple[Condition, Path, int], ...]:
        """Every condition with its path and depth."""
        return tuple(walk(self.rule))

    @cached_property
    def comparisons(self) -> tuple[tuple[Comparison, Path], ...]:
        """Every comparison with its path."""
        return tuple((item, path) for item, path, _ in self.conditions if isinstance(item, Comparison))

    @cached_property
    def actions(self) -> tuple[tuple[Action, Path], ...]:
        """Every action with its path."""
        return tuple((action, ("then", index)) for index, action in enumerate(self.rule.then))

    @cached_property
    def operands(self) -> tuple[Use, ...]:
        """Every operand, those inside calculations included."""
        found: list[Use] = []
        for condition, path in self.comparisons:
            for value, where in values_of(condition, path):
                found += operands_in(value, where, True)
        for action, path in self.actions:
            for value, where in parameters_of(action, path):
                found += operands_in(value, where, False)
        return tuple(found)

    def problem(self, path: Path, code: str, message: str, hint: str = "") -> Problem:
        """Return a problem at a path inside the rule."""
        return self.origin.problem(path, code, f"rule {self.rule.id}{place_of(path)}: {message}", hint)

    def template_of(self, alias: str, *, inside: bool) -> str | None:
        """Return the template an alias stands for."""
        return self.bound.get(alias) or (self.inner.get(alias) if inside else None)

    def info(self, condition: Comparison) -> FieldInfo | None:
        """Return what the vocabulary knows of the field of a comparison."""
        template = self.context.vocabulary.get(condition.fact)
        return template.fields.get(condition.field or "") if template else None

    def field_of(self, reference: FieldRef, *, inside: bool = True) -> FieldInfo | None:
        """Return what the vocabulary knows of a referenced field."""
        alias, name = reference.field.split(".")
        template = self.context.vocabulary.get(self.template_of(alias, inside=inside) or "")
        return template.fields.get(name) if template else None


def values_of(condition: Comparison, path: Path) -> Iterator[tuple[Any, Path]]:
    """Yield what a comparison compares with: its value, or each of a list, with its path."""
    if isinstance(condition.value, list):
        for index, item in enumerate(condition.value):
            yield item, (*path, "value", index)
    elif condition.value is not None:
        yield condition.value, (*path, "value")


def parameters_of(action: Action, path: Path) -> Iterator[tuple[Any, Path]]:
    """Yield the operands of an action with their paths."""
    if isinstance(action, Choose | Repair):
        for name, operand in action.with_.items():
            yield operand, (*path, "with", name)
    elif isinstance(action, Set):
        yield action.to, (*path, "to")


def operands_in(operand: Any, path: Path, inside: bool) -> Iterator[Use]:
    """Yield an operand, and those inside it when it is a calculation."""
    yield Use(operand, path, inside)
    if isinstance(operand, Calculation) and one_operation(operand):
        for item, where in parts_of(operand, path):
            yield from operands_in(item, where, inside)


def one_operation(calculation: Calculation) -> bool:
    """Say whether a calculation says exactly one thing to do."""
    names = calculation.model_fields_set
    return len(names) == 1 and getattr(calculation, next(iter(names))) is not None


def parts_of(calculation: Calculation, path: Path) -> Iterator[tuple[Any, Path]]:
    """Yield the operands of a calculation with their paths."""
    name, operands = calculation.operation()
    listed = isinstance(getattr(calculation, name), list)
    for index, item in enumerate(operands):
        yield item, (*path, name, index) if listed else (*path, name)


def named_operators(action: Action, path: Path) -> Iterator[tuple[str, Path, bool]]:
    """Yield the operator an action names, its path, and whether it may belong to an earlier stage."""
    for kind, key in ((Choose, "choose"), (Repair, "repair"), (Exclude, "exclude"), (Set, "set"), (Adjust, "adjust")):
        if isinstance(action, kind):
            name = getattr(action, key)
            if name != "none" or not isinstance(action, Choose | Repair):
                yield name, (*path, key), isinstance(action, Repair | Adjust)


def thresholds_in(rule: Rule) -> set[str]:
    """Return the named thresholds that a rule uses."""
    found: set[str] = set()
    for condition, path, _ in walk(rule):
        if isinstance(condition, Comparison):
            for value, where in values_of(condition, path):
                found |= {
                    use.operand.threshold
                    for use in operands_in(value, where, True)
                    if isinstance(use.operand, ThresholdRef)
                }
    for index, action in enumerate(rule.then):
        for value, where in parameters_of(action, ("then", index)):
            found |= {
                use.operand.threshold
                for use in operands_in(value, where, True)
                if isinstance(use.operand, ThresholdRef)
            }
    return found


def derived_by(rule: Rule) -> dict[str, str]:
    """Return the findings that a rule derives, with the severity of each."""
    found: dict[str, str] = {}
    for action in rule.then:
        if isinstance(action, Derive | Assess):
            name = action.derive if isinstance(action, Derive) else action.assess
            if SEVERITIES.index(action.severity) >= SEVERITIES.index(found.get(name, SEVERITIES[0])):
                found[name] = action.severity
    return found


def asked_by(rule: Rule) -> set[str]:
    """Return the findings that a rule asks for, positively or not."""
    found: set[str] = set()
    for condition, path, _ in walk(rule):
        if isinstance(condition, FindingCondition):
            found.add(condition.finding)
        elif isinstance(condition, Comparison) and condition.fact == "finding" and condition.field == "name":
            found |= {value for value, _ in values_of(condition, path) if isinstance(value, str)}
    return found
