"""Units of operands: sums need one unit, products make new ones.

A bare constant fits any unit in a sum or a comparison and is a pure factor in a product; a constant that has a unit is
written `{value: 0.1, unit: 1/px}`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, Literal

from expert.rules.checks.context import RuleScope, one_operation, parts_of
from expert.rules.model import Calculation, FieldRef, Quantity, ThresholdRef
from expert.rules.reader import Path

Powers = tuple[tuple[str, int], ...]
Unit = Powers | Literal["any"] | None  # `any`: made of constants only; None: not known
_FACTOR = re.compile(r"([A-Za-z%]+)(-?[0-9]+)?")
_SUFFIXES = frozenset({"px", "dn", "m", "deg", "s", "ms", "mb", "bits", "percent", "fraction"})


def powers_of(unit: str) -> Powers | None:
    """Read a unit such as `dn`, `dn/px`, `px m` or `1/px`; None when it is none.

    Examples
    --------
    >>> powers_of("dn/px")
    (('dn', 1), ('px', -1))
    >>> powers_of("px/px"), powers_of("1"), powers_of("m2")
    ((), (), (('m', 2),))
    """
    found: dict[str, int] = {}
    over, _, under = unit.partition("/")
    for text, sign in ((over, 1), (under, -1)):
        for part in re.split(r"[ *./]+", text.strip()):
            factor = _FACTOR.fullmatch(part)
            if factor:
                found[factor[1]] = found.get(factor[1], 0) + sign * int(factor[2] or 1)
            elif part not in ("", "1"):
                return None
    return tuple(sorted((name, power) for name, power in found.items() if power))


def unit_text(unit: Unit) -> str:
    """Write a unit for people.

    Examples
    --------
    >>> unit_text((("m", 1), ("px", -1)))
    'm/px'
    """
    if unit is None or unit == "any":
        return "an unknown unit"
    over = " ".join(name + (str(power) if power > 1 else "") for name, power in unit if power > 0)
    under = " ".join(name + (str(-power) if power < -1 else "") for name, power in unit if power < 0)
    return (over or "1") + (f"/{under}" if under else "")


def same_unit(first: str, second: str) -> bool:
    """Say whether two units mean the same."""
    return first == second or (powers_of(first) is not None and powers_of(first) == powers_of(second))


def unit_of_parameter(name: str) -> Unit:
    """Read the unit of a parameter off its name, which ends in it; None where it does not.

    Examples
    --------
    >>> unit_of_parameter("max_range_m"), unit_of_parameter("p2_decay_per_dn"), unit_of_parameter("mode")
    ((('m', 1),), (('dn', -1),), None)
    """
    words = name.split("_")
    if len(words) < 2 or words[-1] not in _SUFFIXES:
        return None
    power = -1 if words[-2] == "per" else 1
    return () if words[-1] == "fraction" else ((words[-1], power),)


Clash = Callable[[Path, str, str], None]


def unit_of(scope: RuleScope, operand: Any, path: Path, clash: Clash, *, inside: bool = True) -> Unit:
    """Return the unit of an operand; `clash` is called with the place and both units where a sum mixes two."""
    if isinstance(operand, Quantity):
        return powers_of(operand.unit)
    if isinstance(operand, ThresholdRef):
        threshold = scope.context.threshold(operand.threshold)
        return powers_of(threshold.unit) if threshold else None
    if isinstance(operand, FieldRef):
        info = scope.field_of(operand, inside=inside)
        return powers_of(info.unit) if info else None
    if not isinstance(operand, Calculation):
        return "any"
    if not one_operation(operand):
        return None
    name, _ = operand.operation()
    parts = [(unit_of(scope, item, where, clash, inside=inside), where) for item, where in parts_of(operand, path)]
    return _product(name, [unit for unit, _ in parts]) if name in ("mul", "div") else _sum(name, parts, clash)


def _product(name: str, units: list[Unit]) -> Unit:
    if None in units:
        return None
    if all(unit == "any" for unit in units):
        return "any"
    found: dict[str, int] = {}
    for index, unit in enumerate(units):
        sign = -1 if name == "div" and index else 1
        for base, power in unit if isinstance(unit, tuple) else ():
            found[base] = found.get(base, 0) + sign * power
    return tuple(sorted((base, power) for base, power in found.items() if power))


def _sum(name: str, parts: list[tuple[Unit, Path]], clash: Clash) -> Unit:
    known: Unit = "any"
    for unit, where in parts:
        if unit is None:
            return None
        if known == "any":
            known = unit
        elif unit not in ("any", known):
            clash(where, unit_text(known), unit_text(unit))
            return None
    return known
