"""How far what was measured is from the limits that rules compare it with."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from expert.decision import ConditionRecord
from expert.facts import Fact, Scalar, Vocabulary, is_number
from expert.rules.evaluate import SIGNIFICANT_SIGMAS, Evaluator, Limit, matches_finding
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
    Threshold,
    ThresholdRef,
)
from expert.rules.strata import conditions_of

_UPWARD = {"gt", "ge", "abs_gt", "abs_ge", "significantly_gt"}
_DOWNWARD = {"lt", "le", "abs_lt", "abs_le", "significantly_lt"}


def signed_margin(op: str, value: Scalar | None, limit: Limit | None, sigma: Scalar | None = None) -> float | None:
    """Return how far a number is on the side of its limit where the comparison holds; negative where it does not.

    None where the comparison is no order between numbers.

    Examples
    --------
    >>> signed_margin("ge", 7.5, 6.0), signed_margin("abs_lt", -7.5, 6.0), signed_margin("eq", 1, 1)
    (1.5, -1.5, None)
    """
    if not is_number(value):
        return None
    if op == "between" and isinstance(limit, tuple) and len(limit) == 2 and is_number(limit[0]) and is_number(limit[1]):
        return _rounded(min(value - limit[0], limit[1] - value))
    if not is_number(limit) or op not in _UPWARD | _DOWNWARD:
        return None
    size = abs(value) if op.startswith("abs_") else value
    distance = size - limit if op in _UPWARD else limit - size
    if op.startswith("significantly"):
        if not is_number(sigma):
            return None
        distance -= SIGNIFICANT_SIGMAS * sigma
    return _rounded(distance)


def _rounded(number: float) -> float:
    return float(f"{number:.6g}") + 0.0  # no -0.0


def label(fact: Fact, words: Vocabulary) -> str:
    """Name a fact by its template and the fields that tell it from others of that template."""
    keys = words[fact.template].keys if fact.template in words else ()
    named = ", ".join(f"{key}={fact.get(key)}" for key in keys)
    return f"{fact.template}[{named}]" if named else fact.template


@dataclass(frozen=True)
class MarginReader:
    """Reads the conditions of rules on the facts of one inference.

    Attributes
    ----------
    words : Vocabulary
    thresholds : mapping of str to Threshold
    facts : mapping of str to sequence of Fact
        By template, in canonical order.
    """

    words: Vocabulary
    thresholds: Mapping[str, Threshold]
    facts: Mapping[str, Sequence[Fact]]

    @cached_property
    def _evaluator(self) -> Evaluator:
        return Evaluator(self.words, self.thresholds)

    @classmethod
    def over(cls, words: Vocabulary, thresholds: Mapping[str, Threshold], facts: Iterable[Fact]) -> MarginReader:
        """Return a reader over facts in any order."""
        found: dict[str, list[Fact]] = {}
        for fact in sorted(facts, key=lambda fact: fact.key):
            found.setdefault(fact.template, []).append(fact)
        return cls(words, thresholds, found)

    def conditions(self, rule: Rule, bindings: Mapping[str, Fact]) -> tuple[ConditionRecord, ...]:
        """Return every comparison and finding that a rule asks for, at any depth, with what was measured.

        Parameters
        ----------
        rule : Rule
        bindings : mapping of str to Fact
            What its aliases are bound to. For the others the fact that comes nearest to each limit is taken.
        """
        return tuple(self._read(rule.when, bindings, ()))

    def _read(
        self, conditions: Sequence[Condition], bindings: Mapping[str, Fact], within: tuple[str, ...]
    ) -> Iterator[ConditionRecord]:
        for condition in conditions:
            if isinstance(condition, Comparison):
                yield self._comparison(condition, bindings, within)
            elif isinstance(condition, FindingCondition):
                holds = any(matches_finding(condition, fact) for fact in self.facts.get("finding", ()))
                yield ConditionRecord(text=self._text(condition), holds=holds, within=within)
            elif isinstance(condition, Not):
                yield from self._read(conditions_of(condition.not_), bindings, (*within, "not"))
            elif isinstance(condition, Exists):
                yield from self._read(conditions_of(condition.exists), bindings, (*within, "exists"))
            elif isinstance(condition, AnyOf):
                for number, branch in enumerate(condition.any_of, 1):
                    yield from self._read(conditions_of(branch), bindings, (*within, f"any_of {number}"))
            elif isinstance(condition, ForAll):
                yield from self._read(condition.for_all.where, bindings, (*within, "for_all where"))
                yield from self._read(condition.for_all.then, bindings, (*within, "for_all then"))

    def _comparison(
        self, comparison: Comparison, bindings: Mapping[str, Fact], within: tuple[str, ...]
    ) -> ConditionRecord:
        bound = bindings.get(comparison.name)
        candidates = [bound] if bound is not None else list(self.facts.get(comparison.fact, ()))
        others = {name: facts[0] for name, facts in self.facts.items()}
        read = [
            self._on(comparison, fact, {**others, **bindings, comparison.name: fact}, within) for fact in candidates
        ]
        if not read:
            return ConditionRecord(
                text=self._text(comparison), template=comparison.fact, field=comparison.field, within=within
            )
        return min(read, key=lambda item: (item.margin is None, abs(item.margin or 0.0), not item.holds))

    def _on(
        self, comparison: Comparison, fact: Fact, bindings: Mapping[str, Fact], within: tuple[str, ...]
    ) -> ConditionRecord:
        evaluator = self._evaluator
        value, limit = evaluator.sides(comparison, bindings)
        template = self.words.get(comparison.fact)
        info = template.fields.get(comparison.field or "") if template else None
        sigma = fact.get(info.sigma) if info and info.sigma else None
        named = comparison.value
        return ConditionRecord(
            text=self._text(comparison),
            holds=evaluator.comparison(comparison, bindings),
            template=fact.template,
            fact=label(fact, self.words),
            field=comparison.field,
            op=comparison.op,
            value=value,
            limit=limit,
            unit=info.unit if info else "1",
            threshold=named.threshold if isinstance(named, ThresholdRef) else None,
            margin=signed_margin(comparison.op, value, limit, sigma),
            within=within,
        )

    def _text(self, condition: Condition) -> str:
        return condition_text(condition, self.words, self.thresholds)
