"""A rule in plain English, with units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from expert.facts import Vocabulary
from expert.rules.model import (
    Action,
    AnyOf,
    Assess,
    Calculation,
    Choose,
    Comparison,
    Condition,
    Derive,
    Exclude,
    Exists,
    FieldRef,
    FindingCondition,
    ForAll,
    Measure,
    Not,
    Quantity,
    Repair,
    Rule,
    Set,
    Threshold,
    ThresholdRef,
)

OP_WORDS = {
    "eq": "is {}", "ne": "is not {}", "lt": "is below {}", "le": "is at most {}", "gt": "is above {}",
    "ge": "is at least {}", "abs_lt": "is below {} in magnitude", "abs_le": "is at most {} in magnitude",
    "abs_gt": "is above {} in magnitude", "abs_ge": "is at least {} in magnitude", "in": "is one of {}",
    "not_in": "is none of {}", "present": "is known", "absent": "is not known",
    "significantly_gt": "is above {} by more than its uncertainty",
    "significantly_lt": "is below {} by more than its uncertainty", "between": "is between {}",
}  # fmt: skip
_CALCULATIONS = {"add": " + ", "sub": " - ", "mul": " x ", "div": " / "}


def operand_text(operand: Any, unit: str = "", thresholds: Mapping[str, Threshold] | None = None) -> str:
    """Write an operand: a value with its unit, a field, a threshold with its value, a formula."""
    tail = f" {unit}" if unit and unit != "1" else ""
    if isinstance(operand, FieldRef):
        alias, name = operand.field.split(".")
        return f"the {name} of {alias}"
    if isinstance(operand, ThresholdRef):
        known = (thresholds or {}).get(operand.threshold)
        return f"the threshold {operand.threshold}" + (f" ({known.value:g}{tail})" if known else "")
    if isinstance(operand, Quantity):
        return f"{operand.value:g} {operand.unit}"
    if isinstance(operand, Calculation):
        name, operands = operand.operation()
        parts = [operand_text(item, "", thresholds) for item in operands]
        if name in _CALCULATIONS:
            return "(" + _CALCULATIONS[name].join(parts) + ")"
        return f"{name}({', '.join(parts)})"
    if isinstance(operand, bool):
        return "true" if operand else "false"
    if isinstance(operand, int | float):
        return f"{operand:g}{tail}"
    return str(operand)


def _unit(condition: Comparison, vocabulary: Vocabulary | None) -> str:
    template = (vocabulary or {}).get(condition.fact)
    info = template.fields.get(condition.field or "") if template else None
    if info is not None:
        return info.unit
    if condition.unit:
        return condition.unit
    last = (condition.field or "").rsplit("_", 1)[-1]
    return last if last in ("dn", "px", "m", "deg", "s", "mb") else ""


def _comparison_text(
    condition: Comparison, vocabulary: Vocabulary | None, thresholds: Mapping[str, Threshold] | None
) -> str:
    named = f"{condition.fact} (called {condition.alias})" if condition.alias else condition.fact
    if condition.field is None:
        return f"there is a fact {named}"
    subject = f"the {condition.field} of {named}"
    unit = _unit(condition, vocabulary)
    if isinstance(condition.value, list):
        word = " and " if condition.op == "between" else ", "
        value = word.join(operand_text(item, unit, thresholds) for item in condition.value)
    else:
        value = operand_text(condition.value, unit, thresholds)
    return f"{subject} {OP_WORDS[condition.op].format(value)}"


def condition_text(
    condition: Condition | Sequence[Condition],
    vocabulary: Vocabulary | None = None,
    thresholds: Mapping[str, Threshold] | None = None,
) -> str:
    """Write a condition, or several that hold together, as a clause.

    Examples
    --------
    >>> condition_text(Comparison(fact="brightness", field="offset_dn", op="abs_ge", value=6.0))
    'the offset_dn of brightness is at least 6 dn in magnitude'
    """
    if isinstance(condition, Sequence):
        return " and ".join(condition_text(item, vocabulary, thresholds) for item in condition)
    if isinstance(condition, Comparison):
        return _comparison_text(condition, vocabulary, thresholds)
    if isinstance(condition, FindingCondition):
        least = "" if condition.at_least == "minor" else f" ({condition.at_least} or worse)"
        return f"there is the finding {condition.finding}{least}"
    if isinstance(condition, Not) and isinstance(condition.not_, FindingCondition):
        return condition_text(condition.not_, vocabulary, thresholds).replace("the finding", "no finding", 1)
    if isinstance(condition, Not):
        return f"it is not so that {condition_text(condition.not_, vocabulary, thresholds)}"
    if isinstance(condition, AnyOf):
        return "either " + " or ".join(condition_text(item, vocabulary, thresholds) for item in condition.any_of)
    if isinstance(condition, Exists):
        return f"there is a case in which {condition_text(condition.exists, vocabulary, thresholds)}"
    if isinstance(condition, ForAll):
        where = condition_text(condition.for_all.where, vocabulary, thresholds)
        return f"whenever {where}, also {condition_text(condition.for_all.then, vocabulary, thresholds)}"
    raise TypeError(f"not a condition: {condition!r}")


def _with_text(action: Choose | Repair, thresholds: Mapping[str, Threshold] | None) -> str:
    parts = [f"{name} {operand_text(value, '', thresholds)}" for name, value in sorted(action.with_.items())]
    return f" with {', '.join(parts)}" if parts else ""


def action_text(action: Action, thresholds: Mapping[str, Threshold] | None = None) -> str:
    """Write an action as a command."""
    if isinstance(action, Derive):
        return f"note the {action.severity} finding {action.derive}"
    if isinstance(action, Assess):
        return f"judge the product: {action.severity} finding {action.assess}"
    if isinstance(action, Measure):
        return f"measure {action.measure}"
    if isinstance(action, Choose):
        name = f"nothing for slot {action.slot}" if action.choose == "none" else action.choose
        return f"choose {name}{_with_text(action, thresholds)} (score {action.score:g})"
    if isinstance(action, Repair):
        name = f"nothing in slot {action.slot}" if action.repair == "none" else action.repair
        return f"run again with {name}{_with_text(action, thresholds)} (score {action.score:g})"
    if isinstance(action, Exclude):
        return f"exclude {action.exclude}"
    if isinstance(action, Set):
        return f"set {action.parameter} of {action.set} to {operand_text(action.to, '', thresholds)}"
    step = f"by {action.by:g}" if action.by is not None else f"by a factor of {action.times or 1:g}"
    limits = [f"not below {action.at_least:g}"] if action.at_least is not None else []
    limits += [f"not above {action.at_most:g}"] if action.at_most is not None else []
    tail = f", {' and '.join(limits)}" if limits else ""
    return f"change {action.parameter} of {action.adjust} {step}{tail}"


def sentence(
    rule: Rule, vocabulary: Vocabulary | None = None, thresholds: Mapping[str, Threshold] | None = None
) -> str:
    """Write one rule as a sentence.

    Parameters
    ----------
    rule : Rule
    vocabulary : mapping, optional
        For units; without it they are read off the names of the fields.
    thresholds : mapping, optional
        For the values of named thresholds.
    """
    when = condition_text(rule.when, vocabulary, thresholds)
    then = ", and ".join(action_text(action, thresholds) for action in rule.then)
    because = " ".join(rule.because.split()).rstrip(".")
    return f"In {rule.stage}, when {when}: {then}, because {because[:1].lower()}{because[1:]}."
