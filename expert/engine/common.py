"""What both engines share: the canonical order of facts and firings, and the cap on firings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from expert.facts import Fact, Scalar
from expert.firing import Firing, Firings, RunawayRuleBase


def _scalar_key(value: Scalar) -> tuple[int, Any, str]:
    if isinstance(value, bool):
        return 0, value, "bool"
    return (2, value, "str") if isinstance(value, str) else (1, value, type(value).__name__)


def fact_key(fact: Fact) -> tuple[Any, ...]:
    """Return a key that orders facts totally, values of different kinds included."""
    return fact.template, tuple((name, _scalar_key(value)) for name, value in fact.fields)


def canonical_facts(facts: Iterable[Fact]) -> tuple[Fact, ...]:
    """Sort facts and leave out repetitions, independently of the order in which they are given."""
    return tuple(dict.fromkeys(sorted(facts, key=fact_key)))


def bindings_key(bindings: Iterable[tuple[str, Fact]]) -> tuple[Any, ...]:
    """Return a key that orders bindings totally."""
    return tuple((alias, fact_key(fact)) for alias, fact in bindings)


class Record:
    """The firings of one inference, each kept once, and no more of them than the cap allows.

    Parameters
    ----------
    limit : int
        Greatest number of firings.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._firings: dict[tuple[str, tuple[tuple[str, Fact], ...]], Firing] = {}

    def knows(self, rule: str, bindings: tuple[tuple[str, Fact], ...]) -> bool:
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
        ordered = sorted(self._firings.values(), key=lambda firing: (firing.rule, bindings_key(firing.bindings)))
        return Firings(tuple(ordered), frozenset(facts))
