"""Sets of values that comparisons allow: intervals of numbers, sets of words."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

from expert.facts import FieldInfo
from expert.rules.checks.comparing import NUMERIC, constant, is_number
from expert.rules.checks.context import RuleScope, values_of
from expert.rules.model import Comparison, Scalar


@dataclass(frozen=True, order=True)
class Interval:
    """Numbers from `low` to `high`; an open end does not belong to it."""

    low: float = -math.inf
    high: float = math.inf
    low_open: bool = False
    high_open: bool = False

    @property
    def empty(self) -> bool:
        """Whether it holds no number."""
        return self.low > self.high or (self.low == self.high and (self.low_open or self.high_open))

    def meet(self, other: Interval) -> Interval:
        """Return what both hold."""
        low, low_open = max((self.low, self.low_open), (other.low, other.low_open))
        high, closed = min((self.high, not self.high_open), (other.high, not other.high_open))
        return Interval(low, high, low_open, not closed)

    def within(self, other: Interval) -> bool:
        """Say whether the other one holds all of this one."""
        return self.empty or self.meet(other) == self


@dataclass(frozen=True)
class Numbers:
    """A union of intervals."""

    parts: tuple[Interval, ...]

    @property
    def empty(self) -> bool:
        """Whether nothing is in it."""
        return not self.parts

    def meet(self, other: Region) -> Region:
        """Return what both hold."""
        if not isinstance(other, Numbers):
            return Words(frozenset())
        return _numbers(one.meet(two) for one in self.parts for two in other.parts)

    def within(self, other: Region) -> bool:
        """Say whether the other one holds all of this one."""
        return isinstance(other, Numbers) and all(any(one.within(two) for two in other.parts) for one in self.parts)


@dataclass(frozen=True)
class Words:
    """Words, or booleans; `without` says that these are the ones left out."""

    values: frozenset[Scalar]
    without: bool = False

    @property
    def empty(self) -> bool:
        """Whether nothing is in it."""
        return not self.without and not self.values

    def meet(self, other: Region) -> Region:
        """Return what both hold."""
        if not isinstance(other, Words):
            return Words(frozenset())
        if self.without and other.without:
            return Words(self.values | other.values, True)
        if self.without:
            return Words(other.values - self.values)
        return Words(self.values - other.values if other.without else self.values & other.values)

    def within(self, other: Region) -> bool:
        """Say whether the other one holds all of this one."""
        return self.meet(other) == self


Region: TypeAlias = Numbers | Words


def _numbers(parts: Iterable[Interval]) -> Numbers:
    return Numbers(tuple(sorted(part for part in parts if not part.empty)))


def whole(info: FieldInfo) -> Region:
    """Return every value a field can have."""
    if info.kind in NUMERIC:
        return _numbers([Interval(-math.inf if info.ge is None else info.ge, math.inf if info.le is None else info.le)])
    if info.kind == "boolean":
        return Words(frozenset({True, False}))
    return Words(frozenset(info.choices)) if info.choices else Words(frozenset(), True)


def _integers(region: Numbers) -> Numbers:
    """Shrink intervals to the whole numbers in them."""
    found = []
    for part in region.parts:
        low = math.ceil(part.low) if math.isfinite(part.low) else part.low
        high = math.floor(part.high) if math.isfinite(part.high) else part.high
        low += part.low_open and low == part.low
        high -= part.high_open and high == part.high
        found.append(Interval(low, high))
    return _numbers(found)


def _ordered(op: str, limits: list[float]) -> list[Interval] | None:
    """Return the intervals that an operator on numbers allows."""
    first = limits[0]
    if op in ("abs_gt", "abs_ge") and first < 0:
        return [Interval()]
    table = {
        "lt": [Interval(high=first, high_open=True)],
        "le": [Interval(high=first)],
        "gt": [Interval(low=first, low_open=True)],
        "ge": [Interval(low=first)],
        "abs_lt": [Interval(-first, first, True, True)],
        "abs_le": [Interval(-first, first)],
        "abs_gt": [Interval(high=-first, high_open=True), Interval(low=first, low_open=True)],
        "abs_ge": [Interval(high=-first), Interval(low=first)],
        "between": [Interval(first, limits[-1])],
        "eq": [Interval(first, first)],
        "ne": [Interval(high=first, high_open=True), Interval(low=first, low_open=True)],
        "in": [Interval(limit, limit) for limit in limits],
    }
    if op == "not_in":
        ends = [-math.inf, *sorted(limits), math.inf]
        return [Interval(low, high, True, True) for low, high in itertools.pairwise(ends)]
    return table.get(op)


def region_of(scope: RuleScope, condition: Comparison) -> Region | None:
    """Return the values a comparison with constants allows; None where it depends on other facts."""
    info = scope.info(condition)
    if info is None or condition.op == "absent":
        return None
    if condition.op == "present":
        return whole(info)
    limits = [constant(scope, value) for value, _ in values_of(condition, ())]
    if not limits or None in limits:
        return None
    if info.kind in NUMERIC:
        numbers = [float(limit) for limit in limits if is_number(limit) and limit is not None]
        parts = _ordered(condition.op, numbers) if len(numbers) == len(limits) else None
        if parts is None:
            return None
        region = Numbers(tuple(parts)).meet(whole(info))
        return _integers(region) if info.kind == "integer" and isinstance(region, Numbers) else region
    values = frozenset(limit for limit in limits if limit is not None)
    if condition.op in ("eq", "in"):
        return Words(values).meet(whole(info))
    return Words(values, True).meet(whole(info)) if condition.op in ("ne", "not_in") else None
