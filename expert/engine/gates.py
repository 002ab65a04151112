"""Which rules can fire at all: the numbers that they compare with are sorted, so that one search passes over many."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from expert.facts import Fact, is_number
from expert.rules.evaluate import Evaluator
from expert.rules.model import Comparison, Condition, Not, Rule
from expert.rules.strata import conditions_of

Passes = tuple[tuple[int, int], ...]  # gate and rank of every comparison that some fact has to pass
_Key = tuple[str, str, str]

# How a value is turned so that a comparison asks whether it is above its limit, and whether it may be equal.
_TURNED: Mapping[str, tuple[Callable[[float], float], bool]] = {
    "gt": (lambda value: value, False),
    "ge": (lambda value: value, True),
    "lt": (lambda value: -value, False),
    "le": (lambda value: -value, True),
    "abs_gt": (abs, False),
    "abs_ge": (abs, True),
    "abs_lt": (lambda value: -abs(value), False),
    "abs_le": (lambda value: -abs(value), True),
}


class Gates:
    """The limits of all rules of a layer, by template, field and operator.

    A rule cannot fire if for any comparison that it asks for its rank is not below the number of limits passed, or for
    any that it forbids the rank is below. The converse does not hold: different facts may pass the comparisons of one
    alias.

    Parameters
    ----------
    rules : sequence of Rule
        The rules.
    evaluator : Evaluator
        Evaluates thresholds.

    Attributes
    ----------
    asked, forbidden : tuple of tuple of (int, int)
        For every rule gate and rank of the comparisons that stand alone, and of those alone inside a `not`.
    """

    def __init__(self, rules: Sequence[Rule], evaluator: Evaluator) -> None:
        self._evaluator = evaluator
        asked = [_known(map(self._limit_of, rule.when)) for rule in rules]
        forbidden = [_known(self._limit_of(item) for item in _negated(rule)) for rule in rules]
        limits: dict[_Key, set[float]] = {}
        for found in (*asked, *forbidden):
            for key, limit in found:
                limits.setdefault(key, set()).add(limit)
        self._limits = [(*key, sorted(limits[key])) for key in sorted(limits)]
        self._place = {(template, field, op): index for index, (template, field, op, _) in enumerate(self._limits)}
        self.asked = tuple(map(self._ranks, asked))
        self.forbidden = tuple(map(self._ranks, forbidden))

    def _limit_of(self, condition: Condition) -> tuple[_Key, float] | None:
        """Return the gate of a comparison with a number, and its limit there; None for any other condition."""
        if not isinstance(condition, Comparison) or condition.op not in _TURNED or condition.field is None:
            return None
        limit = self._evaluator.constant(condition)
        if not is_number(limit):
            return None
        return (condition.fact, condition.field, condition.op), -limit if condition.op.endswith(("lt", "le")) else limit

    def _ranks(self, found: Sequence[tuple[_Key, float]]) -> Passes:
        return tuple((self._place[key], bisect_left(self._limits[self._place[key]][3], limit)) for key, limit in found)

    def open(self, facts: Mapping[str, Sequence[Fact]]) -> list[int]:
        """Return for every gate how many of its limits some fact passes, the lowest first.

        Parameters
        ----------
        facts : mapping of str to sequence of Fact
            Facts by template.
        """
        counts = []
        for template, field, op, limits in self._limits:
            turn, equal = _TURNED[op]
            values = [turn(fact.numbers[field]) for fact in facts.get(template, ()) if field in fact.numbers]
            search = bisect_right if equal else bisect_left
            counts.append(search(limits, max(values)) if values else 0)
        return counts


def _known(found: Iterable[tuple[_Key, float] | None]) -> list[tuple[_Key, float]]:
    return [item for item in found if item is not None]


def _negated(rule: Rule) -> Iterator[Condition]:
    """Yield the comparisons that stand alone in a `not` of a rule, on an alias that is bound nowhere else."""
    bound = {item.name for item in rule.when if isinstance(item, Comparison)}
    for condition in rule.when:
        if isinstance(condition, Not):
            inside = conditions_of(condition.not_)
            if len(inside) == 1 and isinstance(inside[0], Comparison) and inside[0].name not in bound:
                yield inside[0]
