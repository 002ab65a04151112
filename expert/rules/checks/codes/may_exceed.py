"""`may-exceed`: a formula that may leave the range of its parameter."""

from __future__ import annotations

import math
from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.checks.parameters import assignments, interval_of, limits_of, plain
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    for item in assignments(context):
        if not item.known or item.scope is None or plain(item.operand):
            continue
        interval = interval_of(item.scope, item.operand)
        low, high = limits_of(item.operator.params, item.parameter)
        if interval is not None and (-math.inf < interval[0] < low or high < interval[1] < math.inf):
            message = (
                f"'{item.parameter}' of '{item.operator.name}' may become {interval[0]:g} to {interval[1]:g}, "
                f"allowed is {low:g} to {high:g}"
            )
            yield item.problem("may-exceed", message, "clamp the formula")


CHECK = Check(
    "may-exceed",
    "warning",
    "A formula may give a parameter a value outside its range for some values of the facts. "
    "An end that is not known, because a field has no declared range, is not reported.",
    "The plan of such a pair would be refused.",
    "Wrap the formula in `clamp`.",
    _find,
)
