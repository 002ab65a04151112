"""A small cache of what an engine has built for a rule base and a stage."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

from expert.rules.model import RuleBase, Stage

Built = TypeVar("Built")
CAPACITY = 32  # a few rule bases of four stages each


class ProgramCache(Generic[Built]):
    """What was built for a rule base, found again by its identity; the least recently used entry goes first.

    A rule base is kept alive by its entry, so that no other one can take its identity.

    Parameters
    ----------
    capacity : int
        Greatest number of entries.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._entries: OrderedDict[tuple[int, Stage], tuple[RuleBase, Built]] = OrderedDict()

    def get(self, rules: RuleBase, stage: Stage, build: Callable[[], Built]) -> Built:
        """Return the entry of a rule base and a stage; build it when there is none."""
        key = id(rules), stage
        if key not in self._entries:
            self._entries[key] = rules, build()
            while len(self._entries) > self._capacity:
                self._entries.popitem(last=False)
        self._entries.move_to_end(key)
        return self._entries[key][1]

    def drop(self, rules: RuleBase, stage: Stage) -> None:
        """Forget one entry."""
        self._entries.pop((id(rules), stage), None)
