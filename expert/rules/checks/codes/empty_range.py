"""`empty-range`: from more to less."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.comparing import comparable, constant, is_number
from expert.rules.checks.context import Context, values_of
from expert.rules.model import Adjust
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        for condition, where in scope.comparisons:
            if condition.op != "between" or comparable(scope, condition) is None:
                continue
            ends = [constant(scope, value) for value, _ in values_of(condition, where)]
            numbers = [float(end) for end in ends if is_number(end) and end is not None]
            if len(numbers) == 2 and numbers[0] > numbers[1]:
                message = f"{numbers[0]:g} to {numbers[1]:g} is an empty range"
                yield scope.problem((*where, "value"), "empty-range", message, "write the smaller value first")
        for action, path in scope.actions:
            if not isinstance(action, Adjust) or action.at_least is None or action.at_most is None:
                continue
            if action.at_least > action.at_most:
                message = f"{action.at_least:g} to {action.at_most:g} is an empty range"
                hint = "write the smaller value under `at_least`"
                yield scope.problem((*path, "at_most"), "empty-range", message, hint)


CHECK = Check(
    "empty-range",
    "error",
    "A range ends below its beginning.",
    "Nothing lies in it.",
    "Write the smaller value first.",
    _find,
)
