"""Which condition decided about a rule, and by how much: a direct reading of the conditions, independent of any engine.

Meant for the few facts of a case, not for inference.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from expert.facts import Fact, Scalar, Vocabulary
from expert.rules.checks.context import walk
from expert.rules.evaluate import Bindings, Evaluator, matches_finding, operand_aliases
from expert.rules.explain import condition_text
from expert.rules.model import (
    AnyOf,
    Comparison,
    Condition,
    Exists,
    FindingCondition,
    ForAll,
    Not,
    Rule,
    RuleBase,
)
from expert.rules.reader import Path
from expert.rules.strata import conditions_of

MAX_BINDINGS = 5000
UNORDERED = frozenset({"present", "absent", "eq", "ne", "in", "not_in"})


@dataclass(frozen=True)
class Deciding:
    """The condition that decided, in words, with what was measured and the limit where there is one number each."""

    condition: str
    value: Scalar | None = None
    limit: Scalar | None = None

    @property
    def margin(self) -> float | None:
        """How far the value is from the limit."""
        if isinstance(self.value, bool | str | None) or isinstance(self.limit, bool | str | None):
            return None
        return float(
            f"{abs(abs(self.value) - self.limit if 'magnitude' in self.condition else self.value - self.limit):.6g}"
        )

    def __str__(self) -> str:
        """Write it as one clause."""
        if self.margin is not None:
            return f"{self.condition}: measured {self.value}, limit {self.limit}, margin {self.margin:g}"
        return f"{self.condition}: measured {self.value}" if self.value is not None else self.condition


class Judge:
    """Reads the conditions of rules on a set of facts."""

    def __init__(self, base: RuleBase, vocabulary: Vocabulary, facts: Iterable[Fact]) -> None:
        self._vocabulary = vocabulary
        self._thresholds = base.thresholds
        self._evaluator = Evaluator(vocabulary, base.thresholds)
        self._facts = tuple(sorted(facts, key=str))

    def _bindings(self, conditions: Sequence[Condition], outer: Bindings) -> Iterator[dict[str, Fact]]:
        wanted = {
            item.name: item.fact for item in conditions if isinstance(item, Comparison) and item.name not in outer
        }
        choices = [[fact for fact in self._facts if fact.template == template] for template in wanted.values()]
        if math.prod(map(len, choices)) > MAX_BINDINGS:
            choices = [self._alone(name, facts, conditions) for name, facts in zip(wanted, choices, strict=True)]
        for combination in itertools.islice(itertools.product(*choices), MAX_BINDINGS):
            yield {**outer, **dict(zip(wanted, combination, strict=True))}

    def _alone(self, name: str, facts: list[Fact], conditions: Sequence[Condition]) -> list[Fact]:
        """Return the facts that satisfy what is asked of one alias alone; all of them where none does."""
        asked = [
            item
            for item in conditions
            if isinstance(item, Comparison) and item.name == name and operand_aliases(item.value) <= {name}
        ]
        found = [fact for fact in facts if all(self._evaluator.comparison(item, {name: fact}) for item in asked)]
        return found or facts

    def _some(self, conditions: Sequence[Condition], outer: Bindings) -> bool:
        return any(all(self.holds(item, bound) for item in conditions) for bound in self._bindings(conditions, outer))

    def holds(self, condition: Condition, bindings: Bindings) -> bool:
        """Say whether a condition holds under bindings."""
        if isinstance(condition, Comparison):
            return self._evaluator.comparison(condition, bindings)
        if isinstance(condition, FindingCondition):
            return any(matches_finding(condition, fact) for fact in self._facts)
        if isinstance(condition, Not):
            return not self._some(conditions_of(condition.not_), bindings)
        if isinstance(condition, Exists):
            return self._some(conditions_of(condition.exists), bindings)
        if isinstance(condition, AnyOf):
            return any(self._some(conditions_of(branch), bindings) for branch in condition.any_of)
        if isinstance(condition, ForAll):
            where, then = condition.for_all.where, condition.for_all.then
            return all(
                self._some(then, bound)
                for bound in self._bindings(where, bindings)
                if all(self.holds(item, bound) for item in where)
            )
        raise TypeError(f"not a condition: {condition!r}")

    def _deciding(self, condition: Condition, bindings: Bindings) -> Deciding:
        text = condition_text(condition, self._vocabulary, self._thresholds)
        inner = condition.not_ if isinstance(condition, Not) else condition
        if isinstance(inner, Comparison):
            bound = bindings if inner.name in bindings else next(self._bindings([inner], bindings), {})
            value, limit = self._evaluator.sides(inner, bound)
            return Deciding(text, value, None if isinstance(limit, tuple) else limit)
        return Deciding(text)

    def first_failing(self, rule: Rule) -> Deciding | None:
        """Return the first condition that fails under the bindings that get furthest, or None when all hold."""
        for condition in rule.when:
            missing = isinstance(condition, Comparison) and not any(
                fact.template == condition.fact for fact in self._facts
            )
            if missing:
                text = condition_text(condition, self._vocabulary, self._thresholds)
                return Deciding(f"{text}: there is no such fact")
        best = -1
        deciding: Deciding | None = None
        for bindings in self._bindings(rule.when, {}):
            failing = next((i for i, item in enumerate(rule.when) if not self.holds(item, bindings)), None)
            if failing is None:
                return None
            if failing > best:
                best, deciding = failing, self._deciding(rule.when[failing], bindings)
        return deciding

    def tightest(self, rule: Rule) -> Deciding | None:
        """Return the top-level comparison of a fired rule that is nearest to its limit."""
        found: list[Deciding] = []
        for bindings in self._bindings(rule.when, {}):
            if all(self.holds(item, bindings) for item in rule.when):
                found += [self._deciding(item, bindings) for item in rule.when]
        near = [item for item in found if item.margin is not None]
        return min(near, key=lambda item: item.margin or 0.0, default=found[0] if found else None)

    def outcomes(self, rule: Rule) -> Iterator[tuple[int, bool]]:
        """Yield what every condition comes to, by its place in `walk`, under every binding of the rule's facts.

        A condition on a fact that is bound only beside it, inside `exists` and the like, says nothing alone: left out.
        """
        found = list(walk(rule))
        present = {fact.template for fact in self._facts}
        top = [item for item, _, depth in found if depth == 0 and isinstance(item, Comparison) and item.fact in present]
        names = {item.name for item, _, depth in found if depth == 0 and isinstance(item, Comparison)}
        for bindings in self._bindings(top, {}):
            for index, (item, _, _) in enumerate(found):
                if isinstance(item, Comparison) and not operand_aliases(item.value) <= {*names, item.name}:
                    continue
                yield index, self._some([item], bindings)

    def at_boundary(self, rule: Rule) -> bool:
        """Say whether some comparison of the rule is exactly at its limit."""
        return next(self.at_limits(rule), None) is not None

    def at_limits(self, rule: Rule) -> Iterator[tuple[Path, Scalar]]:
        """Yield the path and the limit of every comparison that is exactly at its limit."""
        comparisons = [(item, path) for item, path, _ in walk(rule) if isinstance(item, Comparison)]
        ordered = [(item, path) for item, path in comparisons if item.op not in UNORDERED]
        present = {fact.template for fact in self._facts}
        for bindings in self._bindings([item for item, _ in comparisons if item.fact in present], {}):
            for item, path in ordered:
                value, limit = self._evaluator.sides(item, bindings)
                if isinstance(value, int | float) and not isinstance(value, bool):
                    value = abs(value) if item.op.startswith("abs_") else value
                    if value in (limit if isinstance(limit, tuple) else (limit,)):
                        yield path, value


def has_boundary(rule: Rule, vocabulary: Vocabulary) -> bool:
    """Say whether a rule compares some number with a limit, so that a case at the limit is possible."""
    for condition, _, _ in walk(rule):
        if isinstance(condition, Comparison) and condition.op not in UNORDERED:
            template = vocabulary.get(condition.fact)
            info = template.fields.get(condition.field or "") if template else None
            if info is None or info.kind in ("number", "integer"):
                return True
    return False
