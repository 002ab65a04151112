"""What both engines share: the canonical order of facts and firings, conclusions, and the cap on firings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter

from expert.facts import Fact
from expert.firing import Firing, Firings, ResolvedAction, RunawayRuleBase
from expert.rules.evaluate import Bindings, Evaluator, operand_aliases
from expert.rules.model import AnyOf, Comparison, Condition, Exists, ForAll, Not, Rule
from expert.rules.strata import conditions_of

Bound = tuple[tuple[str, Fact], ...]  # the bindings of a firing, sorted by alias


def canonical_facts(facts: Iterable[Fact]) -> tuple[Fact, ...]:
    """Sort facts and leave out repetitions, independently of the order in which they are given."""
    return tuple(dict.fromkeys(sorted(facts, key=attrgetter("key"))))


def conclusions(rule: Rule, evaluator: Evaluator) -> Callable[[Bindings], tuple[ResolvedAction, ...]]:
    """Return the actions of a rule as a function of its bindings, evaluated only once where they need none."""
    fixed = [evaluator.action(index, action, {}) for index, action in enumerate(rule.then)]
    if None not in fixed:
        known = tuple(action for action in fixed if action is not None)
        return lambda _: known

    def conclude(bindings: Bindings) -> tuple[ResolvedAction, ...]:
        found = []
        for index, action in enumerate(rule.then):
            resolved = fixed[index] or evaluator.action(index, action, bindings)
            if resolved is not None:
                found.append(resolved)
        return tuple(found)

    return conclude


def mentioned(conditions: Sequence[Condition]) -> frozenset[str]:
    """Return every alias that conditions speak of, at any depth."""
    found: frozenset[str] = frozenset()
    for condition in conditions:
        if isinstance(condition, Comparison):
            found |= {condition.name} | operand_aliases(condition.value)
        elif isinstance(condition, Not):
            found |= mentioned(conditions_of(condition.not_))
        elif isinstance(condition, Exists):
            found |= mentioned(conditions_of(condition.exists))
        elif isinstance(condition, AnyOf):
            found = found.union(*(mentioned(conditions_of(branch)) for branch in condition.any_of))
        elif isinstance(condition, ForAll):
            found |= mentioned(condition.for_all.where) | mentioned(condition.for_all.then)
    return found


class Record:
    """The firings of one inference, each kept once, and no more of them than the cap allows.

    Parameters
    ----------
    limit : int
        Greatest number of firings.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._firings: dict[tuple[str, Bound], Firing] = {}

    def knows(self, rule: str, bindings: Bound) -> bool:
        """Say whether a rule has fired with these bindings."""
        return (rule, bindings) in self._firings

    def add(self, firing: Firing) -> None:
        """Keep a firing.

        Raises
        ------
        RunawayRuleBase
            There are more firings than the cap allows.
        """
        self._firings[firing.rule, firing.bindings] = firing
        if len(self._firings) > self._limit:
            rule, count = max(Counter(rule for rule, _ in self._firings).items(), key=lambda item: (item[1], item[0]))
            raise RunawayRuleBase(
                f"inference was ended after {self._limit} firings, the most allowed; rule {rule} fired most, "
                f"{count} times: join its facts more narrowly"
            )

    def finish(self, facts: Iterable[Fact]) -> Firings:
        """Return the firings in canonical order."""
        return Firings(tuple(sorted(self._firings.values(), key=_firing_key)), frozenset(facts))


def _firing_key(firing: Firing) -> tuple[object, ...]:
    return firing.rule, tuple((alias, fact.key) for alias, fact in firing.bindings)
