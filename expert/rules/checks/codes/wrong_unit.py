"""`wrong-unit`: quantities of different units compared, added or assigned."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.comparing import NUMERIC, comparable
from expert.rules.checks.context import Context, RuleScope, one_operation, values_of
from expert.rules.checks.parameters import assignments, is_numeric
from expert.rules.checks.units import Unit, powers_of, same_unit, unit_of, unit_of_parameter, unit_text
from expert.rules.model import Calculation, Comparison, FieldRef, Quantity, ThresholdRef
from expert.rules.problem import Problem
from expert.rules.reader import Path

_CODE = "wrong-unit"
_PRODUCT = "convert it, or give the constants of the product their units, e.g. {value: 0.1, unit: 1/px}"


class _Units:
    """Works out units in one rule and collects what clashes on the way."""

    def __init__(self, scope: RuleScope) -> None:
        self.scope = scope
        self.found: list[Problem] = []

    def of(self, operand: object, path: Path, *, inside: bool) -> Unit:
        return unit_of(self.scope, operand, path, self._clash, inside=inside)

    def _clash(self, path: Path, first: str, second: str) -> None:
        message = f"the formula mixes {first} and {second}, which cannot be added or compared"
        self.found.append(self.scope.problem(path, _CODE, message, "calculate with quantities of one unit"))


def _hint(operand: object, plain: str) -> str:
    return _PRODUCT if isinstance(operand, Calculation) and {"mul", "div"} & _operations(operand) else plain


def _operations(operand: object) -> set[str]:
    if not isinstance(operand, Calculation) or not one_operation(operand):
        return set()
    name, parts = operand.operation()
    return {name}.union(*(_operations(part) for part in parts))


def _named(value: object) -> str:
    if isinstance(value, ThresholdRef):
        return f"threshold '{value.threshold}'"
    return f"'{value.field}'" if isinstance(value, FieldRef) else "what it is compared with"


def _comparison(units: _Units, condition: Comparison, path: Path) -> Iterator[Problem]:
    scope, info = units.scope, units.scope.info(condition)
    if info is None:
        return
    if condition.unit is not None and not same_unit(condition.unit, info.unit):
        message = f"'{info.name}' is in {info.unit}, not in {condition.unit}"
        yield scope.problem((*path, "unit"), _CODE, message, "convert the value")
    if comparable(scope, condition) is None or info.kind not in NUMERIC:
        return
    for value, where in values_of(condition, path):
        unit = units.of(value, where, inside=True)
        if isinstance(unit, tuple) and unit != powers_of(info.unit):
            said = f"'{info.name}' is in {info.unit}, {_named(value)} in {unit_text(unit)}"
            hint = _hint(value, "compare quantities of one unit")
            yield scope.problem(where, _CODE, said, hint)


def _find(context: Context) -> Iterator[Problem]:
    for scope in context.scopes:
        units = _Units(scope)
        for condition, path in scope.comparisons:
            yield from _comparison(units, condition, path)
        yield from units.found
    for item in assignments(context):
        if (
            not item.known
            or item.scope is None
            or not is_numeric(item.operator.params.model_fields[item.parameter].annotation)
        ):
            continue
        units = _Units(item.scope)
        unit, wanted = units.of(item.operand, item.path, inside=False), unit_of_parameter(item.parameter)
        yield from units.found
        if isinstance(unit, tuple) and wanted is not None and unit != wanted:
            message = f"{item.label} is in {unit_text(wanted)}, but the value is in {unit_text(unit)}"
            hint = _hint(item.operand, "give it a quantity of that unit")
            yield item.problem(_CODE, message, hint)
    for _, (threshold, origin) in context.merged.thresholds.items():
        if powers_of(threshold.unit) is None:
            message = f"'{threshold.unit}' is not a unit"
            yield origin.problem(("unit",), _CODE, message, "write e.g. dn, px, m, deg, dn/px, 1")
    for scope in context.scopes:
        for use in scope.operands:
            if isinstance(use.operand, Quantity) and powers_of(use.operand.unit) is None:
                message = f"'{use.operand.unit}' is not a unit"
                yield scope.problem((*use.path, "unit"), _CODE, message, "write e.g. dn, px, m, deg, dn/px, 1/px")


CHECK = Check(
    _CODE,
    "error",
    "Quantities of different units are compared, added or assigned.",
    "Six pixels and six grey levels are not equal; a number that lost its unit on the way is a dear mistake.",
    "Compare and add quantities of one unit. In a product a bare constant is a pure factor; "
    "a constant that has a unit is written `{value: 0.1, unit: 1/px}`.",
    _find,
)
