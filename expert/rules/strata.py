"""Stratification: in which order rules may look for the absence of findings.

A rule that asks whether a finding is absent (`not`) or what holds for all of them (`for_all`) must wait until every
rule that may derive it has had its turn. Such waiting must not go in a circle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from expert.rules.evaluate import finding_of
from expert.rules.model import AnyOf, Comparison, Condition, Exists, FindingCondition, ForAll, Not, Rule

EVERY_FINDING = "*"


class CyclicNegation(ValueError):
    """Rules wait for each other's findings through `not` or `for_all`.

    Attributes
    ----------
    rules : tuple of str
        The rules on the cycle, in order; the first waits for the second, and so on, the last waits for the first.
    """

    def __init__(self, rules: Sequence[str]) -> None:
        self.rules = tuple(rules)
        cycle = " -> ".join((*self.rules, self.rules[0]))
        super().__init__(
            f"rules {cycle} depend on each other's findings through `not` or `for_all`; "
            "derive the finding without asking for its own absence"
        )


@dataclass(frozen=True)
class FindingUse:
    """A finding that a condition asks for; `name` is `*` for a condition that may match any finding."""

    name: str
    negated: bool


def conditions_of(group: Condition | list[Condition]) -> tuple[Condition, ...]:
    """Return one condition or several as a tuple."""
    return tuple(group) if isinstance(group, list) else (group,)


def uses(conditions: Sequence[Condition], negated: bool = False) -> Iterator[FindingUse]:
    """Yield every finding that conditions ask for."""
    for condition in conditions:
        if isinstance(condition, FindingCondition):
            yield FindingUse(condition.finding, negated)
        elif isinstance(condition, Comparison):
            if condition.fact == "finding":
                yield FindingUse(_named_finding(condition, conditions), negated)
        elif isinstance(condition, Not):
            yield from uses(conditions_of(condition.not_), True)
        elif isinstance(condition, Exists):
            yield from uses(conditions_of(condition.exists), negated)
        elif isinstance(condition, AnyOf):
            for branch in condition.any_of:
                yield from uses(conditions_of(branch), negated)
        elif isinstance(condition, ForAll):
            yield from uses(condition.for_all.where, True)
            yield from uses(condition.for_all.then, True)


def stratify(rules: Iterable[Rule]) -> tuple[tuple[Rule, ...], ...]:
    """Order rules into layers, each of which only negates findings of earlier layers.

    Parameters
    ----------
    rules : iterable of Rule
        Rules of one stage.

    Returns
    -------
    tuple of tuples of Rule
        Layers in the order of evaluation; within a layer by id.

    Raises
    ------
    CyclicNegation
        A rule depends on its own finding through `not` or `for_all`.
    """
    ordered = tuple(sorted(rules, key=lambda rule: rule.id))
    edges = _edges(ordered)
    level = [0] * len(ordered)
    for _ in range(len(ordered) + 1):
        changed = False
        for index, targets in enumerate(edges):
            needed = max((level[other] + negated for other, negated in targets), default=0)
            if needed > level[index]:
                level[index] = needed
                changed = True
        if not changed:
            break
    else:
        raise CyclicNegation(_cycle(ordered, edges))
    return tuple(
        tuple(rule for rule, own in zip(ordered, level, strict=True) if own == layer) for layer in sorted(set(level))
    )


def with_sources(rules: Iterable[Rule], wanted: Callable[[Rule], bool]) -> tuple[Rule, ...]:
    """Return the wanted rules of one stage and those that derive what they ask for, directly or not, by id.

    They fire as they do among all rules.
    """
    ordered = tuple(sorted(rules, key=lambda rule: rule.id))
    edges = _edges(ordered)
    found = [index for index, rule in enumerate(ordered) if wanted(rule)]
    for index in found:  # grows while it is read
        found += sorted({other for other, _ in edges[index]} - set(found))
    return tuple(ordered[index] for index in sorted(found))


def _named_finding(comparison: Comparison, siblings: Sequence[Condition]) -> str:
    """Return the one name that an alias is restricted to by its own conditions, else `*`."""
    for other in siblings:
        if not isinstance(other, Comparison) or (other.fact, other.name) != ("finding", comparison.name):
            continue
        if other.field == "name" and other.op == "eq" and isinstance(other.value, str):
            return other.value
    return EVERY_FINDING


def _edges(rules: Sequence[Rule]) -> list[list[tuple[int, bool]]]:
    """Return for every rule the rules it depends on, and whether through a negation."""
    producers: dict[str, list[int]] = {}
    for index, rule in enumerate(rules):
        for name in sorted({str(fact.get("name")) for fact in map(finding_of, rule.then) if fact is not None}):
            producers.setdefault(name, []).append(index)
            producers.setdefault(EVERY_FINDING, []).append(index)
    edges: list[list[tuple[int, bool]]] = []
    for rule in rules:
        targets = {(other, use.negated) for use in uses(rule.when) for other in producers.get(use.name, ())}
        edges.append(sorted(targets))
    return edges


def _cycle(rules: Sequence[Rule], edges: Sequence[Sequence[tuple[int, bool]]]) -> list[str]:
    """Return the shortest cycle through a negation."""
    best: list[int] = []
    for start, targets in enumerate(edges):
        for first in (other for other, negated in targets if negated):
            path = _path(edges, first, start)
            if path and (not best or len(path) < len(best)):
                best = [start, *path[:-1]]
    return [rules[index].id for index in best]


def _path(edges: Sequence[Sequence[tuple[int, bool]]], start: int, goal: int) -> list[int]:
    """Return the shortest path between two rules, both included."""
    previous = {start: -1}
    queue = [start]
    for node in queue:
        if node == goal:
            path = [node]
            while previous[path[-1]] >= 0:
                path.append(previous[path[-1]])
            return path[::-1]
        for other, _ in edges[node]:
            if other not in previous:
                previous[other] = node
                queue.append(other)
    return []
