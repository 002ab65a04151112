"""How values, facts and steps are written: what all renderings share."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from expert.decision import Decision, FactRecord, FiringRecord
from expert.facts import Vocabulary, vocabulary
from expert.plan import Step
from modules.catalog import operators, probes


@cache
def known_words() -> Vocabulary:
    """Return the vocabulary of the installed probes."""
    return vocabulary(probes().values())


def number_text(value: object) -> str:
    """Write a value for people: four significant digits, lists and tuples alike."""
    if isinstance(value, list | tuple):
        return ", ".join(number_text(item) for item in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def unit_text(template: str, field: str) -> str:
    """Return the unit of a field with a blank before it; empty where it has none."""
    known = known_words().get(template)
    info = known.fields.get(field) if known else None
    return f" {info.unit}" if info and info.unit != "1" else ""


def fact_title(record: FactRecord) -> str:
    """Name a fact; those of one template are told apart by their keys, as in `histogram[left, red]`."""
    known = known_words().get(record.template)
    which = ", ".join(str(record.fields[key]) for key in (known.keys if known else ()) if key in record.fields)
    return f"{record.template}[{which}]" if which else record.template


def short_title(label: str) -> str:
    """Name a fact like `fact_title` what `expert.margins.label` named with its keys.

    Examples
    --------
    >>> short_title("histogram[side=left, channel=red]")
    'histogram[left, red]'
    """
    template, bracket, keys = label.partition("[")
    return template + bracket + ", ".join(part.partition("=")[2] or part for part in keys.split(", "))


def fact_text(record: FactRecord) -> str:
    """Write a fact as `template: field value unit, ...`."""
    parts = [f"{name} {number_text(value)}{unit_text(record.template, name)}" for name, value in record.fields.items()]
    return f"{record.template}: {', '.join(parts)}"


def summary_of(operator: str) -> str:
    """Say what an operator does."""
    catalog = operators()
    return catalog[operator].summary if operator in catalog else "nothing is done in this slot"


def parameter_text(step: Step) -> str:
    """Write the parameters that rules have set, with a leading blank."""
    named = [f"{name}={number_text(value)}" for name, value in sorted(step.parameters.items()) if name in step.set_by]
    return f" ({', '.join(named)})" if named else ""


def firings_of(decision: Decision, rule: str) -> list[FiringRecord]:
    """Return the firings of one rule."""
    return [firing for firing in decision.firings if firing.rule == rule]


def why(decision: Decision, step: Step) -> str:
    """Say who chose an operator and why."""
    if step.chosen_by is None:
        return "the default of its slot; no rule chose another"
    firings = firings_of(decision, step.chosen_by)
    if firings:
        return f"{step.chosen_by} {firings[0].name}: {firings[0].because}"
    return f"{step.chosen_by}, asked for after an earlier trial"


def settings(decision: Decision, step: Step) -> Iterator[str]:
    """Say which rules set parameters of an operator that they did not choose, and why."""
    for parameter, rule in step.set_by.items():
        if rule not in (step.chosen_by, "default"):
            firings = firings_of(decision, rule)
            reason = f"{rule} {firings[0].name}: {firings[0].because}" if firings else f"{rule}, after an earlier trial"
            yield f"{parameter}={number_text(step.parameters[parameter])} by {reason}"


def losers_text(step: Step) -> Iterator[str]:
    """Say what lost a slot and its parameters, to whom, and why."""
    for loser in step.losers:
        if loser.rule is None and loser.operator == step.operator:
            continue  # a rule gave the default its parameters: nothing was beaten
        yield f"{loser.operator} ({loser.rule or 'default'}, score {loser.score:g}): {loser.lost_because}"
    for setting in step.lost_settings:
        value = number_text(setting.value)
        yield f"{setting.parameter}={value} of {setting.operator} ({setting.rule}): {setting.lost_because}"
