"""What inference returns: firings in a canonical order, whatever engine made them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from expert.facts import Fact, Scalar
from expert.rules.model import RuleBase, Stage

MAX_FIRINGS = 10_000


@dataclass(frozen=True, order=True)
class ResolvedAction:
    """One action of a fired rule with its operands evaluated.

    Attributes
    ----------
    index : int
        Position in the rule's `then`.
    kind : str
        derive, measure, choose, exclude, set, assess, adjust or repair.
    values : tuple of (name, value)
        Values of its operands by name: the parameters of choose and repair, `to` of set.
    """

    index: int
    kind: str
    values: tuple[tuple[str, Scalar], ...] = ()


@dataclass(frozen=True, order=True)
class Firing:
    """One rule that fired, and the facts its aliases were bound to, sorted by alias."""

    rule: str
    bindings: tuple[tuple[str, Fact], ...]
    actions: tuple[ResolvedAction, ...] = ()


@dataclass(frozen=True)
class Firings:
    """All firings of one inference, sorted, and the facts after it (given and derived)."""

    firings: tuple[Firing, ...]
    facts: frozenset[Fact]


class RunawayRuleBase(RuntimeError):
    """Inference was ended because it exceeded the cap on firings."""


class Engine(Protocol):
    """An inference engine."""

    name: str

    def infer(self, rules: RuleBase, stage: Stage, facts: Iterable[Fact]) -> Firings:
        """Fire every rule of one stage that the facts satisfy, until nothing new follows."""
        ...
