"""What follows from conditions: whether they can hold at all, exclude others, or imply others.

Sound and incomplete: what is said here is true; what is not said may be true as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from expert.facts import SEVERITIES
from expert.rules.checks.context import RuleScope, children, each
from expert.rules.checks.regions import Region, region_of
from expert.rules.model import AnyOf, Comparison, Condition, FindingCondition, Not, Scalar
from expert.rules.reader import Path

Instance = tuple[str, str, tuple[tuple[str, Scalar], ...]]  # template, alias or "", values of its keys
Place = tuple[Instance, str]  # and field


@dataclass
class Conjunction:
    """Conditions that have to hold together, read as sets of allowed values."""

    scope: RuleScope
    conditions: tuple[tuple[Condition, Path], ...]
    allowed: dict[Place, Region] = field(default_factory=dict)
    regions: dict[Path, tuple[Instance, Region]] = field(default_factory=dict)
    clash: tuple[Path, Path] | None = None  # two conditions that exclude each other; the same one twice: it alone

    @classmethod
    def of(cls, scope: RuleScope, conditions: Iterable[tuple[Condition, Path]]) -> Conjunction:
        """Read conditions that hold together."""
        found = cls(scope, tuple(conditions))
        seen: dict[Place, list[tuple[Path, Region]]] = {}
        for condition, path in found.conditions:
            if isinstance(condition, Comparison) and (region := region_of(scope, condition)) is not None:
                place = (found.instance(condition), condition.field or "")
                found.regions[path] = (place[0], region)
                earlier = found.allowed.get(place)
                met = region if earlier is None else earlier.meet(region)
                if met.empty and found.clash is None:
                    guilty = (where for where, other in seen.get(place, []) if other.meet(region).empty)
                    found.clash = (path, path) if region.empty else (next(guilty, seen[place][0][0]), path)
                seen.setdefault(place, []).append((path, region))
                found.allowed[place] = met
        if found.clash is None:
            found.clash = next(found._contradictions(), None)
        return found

    def _contradictions(self) -> Iterator[tuple[Path, Path]]:
        for plain, path in self.conditions:
            for negated, where in self.conditions:
                if isinstance(negated, Not) and not isinstance(negated.not_, list):
                    if negated.not_ == plain or self._same_finding(plain, negated.not_):
                        yield path, where
                elif isinstance(plain, Comparison) and isinstance(negated, Comparison) and negated.op == "absent":
                    same = self.instance(plain) == self.instance(negated) and plain.field == negated.field
                    if same and plain.op != "absent":
                        yield path, where

    @staticmethod
    def _same_finding(plain: Condition, other: Condition) -> bool:
        return isinstance(plain, FindingCondition) and isinstance(other, FindingCondition) and _stronger(plain, other)

    def instance(self, condition: Comparison) -> Instance:
        """Tell which fact a comparison speaks of; a fact whose keys are all given is the same under any alias."""
        template = self.scope.context.vocabulary.get(condition.fact)
        keys = template.keys if template else ()
        if not keys:
            return condition.fact, "", ()
        given: dict[str, Scalar] = {}
        for other, _ in self.conditions:
            if not isinstance(other, Comparison) or other.name != condition.name or other.op != "eq":
                continue
            if other.field in keys and isinstance(other.value, bool | int | float | str):
                given[other.field] = other.value
        if len(given) == len(keys):
            return condition.fact, "", tuple(sorted(given.items()))
        return condition.fact, condition.name, ()

    def excludes(self, other: Conjunction) -> bool:
        """Say whether the two can be seen never to hold together."""
        for place, region in self.allowed.items():
            if not place[0][1] and place in other.allowed and region.meet(other.allowed[place]).empty:
                return True
        return any(
            isinstance(negated, Not)
            and not isinstance(negated.not_, list)
            and its.says_of_all(negated.not_)
            and mine.implies_one(negated.not_)
            for mine, its in ((self, other), (other, self))
            for negated, _ in its.conditions
        )

    def bound(self, condition: Condition) -> frozenset[str]:
        """Return the aliases of facts with keys that a condition speaks of and that are bound beside it."""
        names = {item.name for item, _ in self.conditions if isinstance(item, Comparison)}
        return frozenset(
            item.name
            for item in _comparisons(condition)
            if item.name in names and self.instance(item) != (item.fact, "", ())
        )

    def says_of_all(self, negated: Condition) -> bool:
        """Say whether the negation of a condition speaks of every fact, not only of one that is bound beside it."""
        return not self.bound(negated)

    def implies(self, other: Conjunction) -> bool:
        """Say whether the other holds whenever this one does."""
        return all(self._implies(condition, path, other) for condition, path in other.conditions)

    def _implies(self, condition: Condition, path: Path, other: Conjunction) -> bool:
        read = other.regions.get(path)
        if read is not None and isinstance(condition, Comparison):
            mine = self.allowed.get((read[0], condition.field or ""))
            return (mine is not None and mine.within(read[1])) or any(item == condition for item, _ in self.conditions)
        return self.implies_one(condition, other)

    def implies_one(self, condition: Condition, other: Conjunction | None = None) -> bool:
        """Say whether one condition, of another conjunction, holds whenever this one does."""
        if any(mine == condition for mine, _ in self.conditions):
            plain = isinstance(condition, Comparison | FindingCondition)
            if other is None or plain or self.bound(condition) == other.bound(condition):
                return True
        if isinstance(condition, Comparison):
            instance = (other or self).instance(condition)
            if condition.field is None:
                return any(mine[0] == instance for mine in self.allowed)
            mine = self.allowed.get((instance, condition.field))
            region = region_of(self.scope, condition)
            return mine is not None and region is not None and mine.within(region)
        if isinstance(condition, FindingCondition):
            return any(isinstance(mine, FindingCondition) and _stronger(mine, condition) for mine, _ in self.conditions)
        if isinstance(condition, AnyOf):
            return any(
                all(self.implies_one(item, other) for item, _ in each(branch, ())) for branch in condition.any_of
            )
        return False


def _comparisons(condition: Condition) -> Iterator[Comparison]:
    """Yield the comparisons in a condition, itself included."""
    if isinstance(condition, Comparison):
        yield condition
    for child, _ in children(condition, ()):
        yield from _comparisons(child)


def _stronger(first: FindingCondition, second: FindingCondition) -> bool:
    """Say whether the second finding is there whenever the first one is."""
    return first.finding == second.finding and SEVERITIES.index(first.at_least) >= SEVERITIES.index(second.at_least)


def of_rule(scope: RuleScope) -> Conjunction:
    """Read the conditions of a rule, once."""
    if scope.reading is None:
        top = [(condition, path) for condition, path, depth in scope.conditions if depth == 0]
        scope.reading = Conjunction.of(scope, top)
    return scope.reading


def groups(scope: RuleScope) -> Iterator[tuple[Path, Sequence[tuple[Condition, Path]]]]:
    """Yield every group of conditions that have to hold together: the rule's own, and those inside others."""
    top = [(condition, path) for condition, path, depth in scope.conditions if depth == 0]
    yield (), top
    for condition, path, _ in scope.conditions:
        if isinstance(condition, AnyOf):
            for index, branch in enumerate(condition.any_of):
                yield (*path, "any_of", index), list(each(branch, (*path, "any_of", index)))
        else:
            for key, attribute in (("not", "not_"), ("exists", "exists")):
                inner = getattr(condition, attribute, None)
                if inner is not None:
                    yield (*path, key), list(each(inner, (*path, key)))
            body = getattr(condition, "for_all", None)
            if body is not None:
                yield (*path, "for_all", "where"), list(each(body.where, (*path, "for_all", "where")))
                yield (*path, "for_all", "then"), list(each(body.then, (*path, "for_all", "then")))
