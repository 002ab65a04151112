"""Which rules can fire at all: the numbers that they compare with are sorted, so that one search passes over many."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence

from expert.facts import Fact, is_number
from expert.rules.evaluate import Evaluator
from expert.rules.model import Comparison, Rule

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

    A rule whose rank is not below the number of limits passed, for any of its comparisons, cannot fire. The converse
    does not hold: different facts may pass the comparisons of one alias.

    Parameters
    ----------
    rules : sequence of Rule
        The rules.
    evaluator : Evaluator
        Evaluates thresholds.
    """

    def __init__(self, rules: Sequence[Rule], evaluator: Evaluator) -> None:
        asked: dict[_Key, set[float]] = {}
        asking: list[list[tuple[_Key, float]]] = []
        for rule in rules:
            found: list[tuple[_Key, float]] = []
            for condition in rule.when:
                if isinstance(condition, Comparison) and condition.op in _TURNED and condition.field is not None:
                    limit = evaluator.constant(condition)
                    if is_number(limit):
                        key = condition.fact, condition.field, condition.op
                        turned = -limit if condition.op.endswith(("lt", "le")) else limit
                        asked.setdefault(key, set()).add(turned)
                        found.append((key, turned))
            asking.append(found)
        self._limits = [(*key, sorted(asked[key])) for key in sorted(asked)]
        place = {(template, field, op): index for index, (template, field, op, _) in enumerate(self._limits)}
        self.passes: tuple[Passes, ...] = tuple(
            tuple((place[key], bisect_left(self._limits[place[key]][3], limit)) for key, limit in found)
            for found in asking
        )

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
