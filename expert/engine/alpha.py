"""Alpha conditions: what one fact has to fulfil by itself, shared by all rules that ask the same of it."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from expert.facts import Fact, is_number
from expert.rules.evaluate import Evaluator, holds, operand_aliases
from expert.rules.model import Comparison

FactTest = Callable[[Fact], bool]
_ORDERS: Mapping[str, Callable[[Any, Any], bool]] = {
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
}


class Alpha:
    """Tests on one fact of a template.

    Attributes
    ----------
    index : int
        Its place among the alpha conditions of a program.
    """

    __slots__ = ("index", "template", "tests")

    def __init__(self, index: int, template: str, tests: tuple[FactTest, ...]) -> None:
        self.index, self.template, self.tests = index, template, tests

    def admits(self, fact: Fact) -> bool:
        """Say whether a fact of the template passes all tests."""
        for test in self.tests:  # noqa: SIM110 - a generator would double the time
            if not test(fact):
                return False
        return True


class Alphas:
    """The alpha conditions of a program, each once.

    Parameters
    ----------
    evaluator : Evaluator
        Evaluates the comparisons.
    """

    def __init__(self, evaluator: Evaluator) -> None:
        self._evaluator = evaluator
        self._known: dict[tuple[str, tuple[str, ...]], Alpha] = {}

    def __len__(self) -> int:
        return len(self._known)

    def of(self, template: str, comparisons: Sequence[Comparison]) -> Alpha:
        """Return the condition that comparisons on one alias are together; none of them speaks of another alias."""
        asking = [
            item for item in comparisons if item.field is not None or item.op != "present" or item.fact != template
        ]
        key = template, tuple(sorted(map(_content, asking)))
        if key not in self._known:
            tests = tuple(_test(item, template, self._evaluator) for item in asking)
            self._known[key] = Alpha(len(self._known), template, tests)
        return self._known[key]


def _content(comparison: Comparison) -> str:
    """Return what a comparison asks, without the name of its alias where that says nothing."""
    alias = comparison.name if operand_aliases(comparison.value) else ""
    return repr((alias, comparison.fact, comparison.field, comparison.op, comparison.value))


def _test(comparison: Comparison, template: str, evaluator: Evaluator) -> FactTest:
    """Return one comparison as a function of the fact alone, the most frequent kinds by the shortest way."""
    field, op, name = comparison.field, comparison.op, comparison.name
    if comparison.fact != template or field is None:
        return lambda _: False
    if operand_aliases(comparison.value) or op.startswith("significantly"):
        return lambda fact: evaluator.comparison(comparison, {name: fact})
    limit = evaluator.constant(comparison)
    if op in _ORDERS and is_number(limit):
        return _order(field, _ORDERS[op], limit)
    if op == "eq" and isinstance(limit, bool | str):
        return _equality(field, limit)
    return lambda fact: holds(op, fact.values.get(field), limit)


def _order(field: str, order: Callable[[Any, Any], bool], limit: float) -> FactTest:
    def test(fact: Fact) -> bool:
        value = fact.numbers.get(field)
        return value is not None and order(value, limit)

    return test


def _equality(field: str, limit: bool | str) -> FactTest:
    kind = type(limit)

    def test(fact: Fact) -> bool:
        value = fact.values.get(field)
        return value == limit and type(value) is kind

    return test
