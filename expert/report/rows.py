"""The tables of a report: facts, rules that fired, and what fills the slots; data that every rendering lays out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

from expert.decision import ConditionRecord, Decision
from expert.facts import FieldInfo
from expert.plan import Step
from expert.report.answers import Answers
from expert.report.words import (
    fact_text,
    fact_title,
    known_words,
    losers_text,
    number_text,
    parameter_text,
    settings,
    summary_of,
    why,
)

T = TypeVar("T")
INTERNAL = ("finding", "planned", "trial", "failure")  # facts about the inference itself


@dataclass(frozen=True)
class FactRow:
    """One field of a fact.

    Attributes
    ----------
    fact : str
        Title of the fact, as in `histogram[left, red]`.
    name : str
        The same with the field.
    limits : str
        Range that the value can have.
    nearest : str
        The limit of a rule that the value is nearest to.
    mattered : bool
        Whether a rule fired on the fact.
    """

    fact: str
    name: str
    value: str
    unit: str
    limits: str
    meaning: str
    probe: str
    nearest: str
    mattered: bool


@dataclass(frozen=True)
class Choice:
    """One slot of the plan: what fills it, why, and what lost."""

    stage: str
    slot: str
    operator: str
    summary: str
    parameters: str
    why: str
    settings: tuple[str, ...]
    losers: tuple[str, ...]


@dataclass(frozen=True)
class RuleFired:
    """One rule that fired in one stage.

    Attributes
    ----------
    text : str
        What the rule says; empty where the record carries no rules.
    conditions, actions : tuple of str
        What was compared, with values and margins, and what was concluded.
    bindings : tuple of tuple of (str, str)
        For each firing the facts by alias.
    """

    rule: str
    name: str
    stage: str
    text: str
    because: str
    references: tuple[str, ...]
    conditions: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    bindings: tuple[tuple[tuple[str, str], ...], ...] = ()


def _limits(info: FieldInfo | None) -> str:
    if info is None:
        return ""
    if info.choices:
        return " | ".join(info.choices)
    low, high = (None if bound is None else f"{bound:g}" for bound in (info.ge, info.le))
    if low is not None and high is not None:
        return f"{low} to {high}"
    if low is not None:
        return f"from {low}"
    return "" if high is None else f"to {high}"


def fact_rows(decision: Decision, answers: Answers) -> list[FactRow]:
    """Return every field of every fact, by name."""
    return sorted(_fact_rows(decision, answers), key=lambda row: row.name)


def _fact_rows(decision: Decision, answers: Answers) -> Iterator[FactRow]:
    nearest, words = answers.nearest or {}, known_words()
    bound = [record for firing in decision.firings for record in firing.bindings.values()]
    for record in decision.facts:
        template = words.get(record.template)
        fields = template.fields if template else {}
        title = fact_title(record)
        matters = any(other.template == record.template and other.fields == record.fields for other in bound)
        for name, value in record.fields.items():
            if template is not None and name in template.keys:
                continue
            info = fields.get(name)
            yield FactRow(
                title,
                f"{title}.{name}",
                number_text(value),
                info.unit if info and info.unit != "1" else "",
                _limits(info),
                info.description if info else "",
                record.probe or "stated",
                nearest.get(f"{title}.{name}", ""),
                matters,
            )


def choices(decision: Decision) -> list[Choice]:
    """Return every slot of the plan, in the order they run."""
    return [_choice(decision, stage, step) for stage, plan in decision.plans.items() for step in plan.steps]


def _choice(decision: Decision, stage: str, step: Step) -> Choice:
    return Choice(
        stage,
        step.slot,
        step.operator,
        summary_of(step.operator),
        parameter_text(step).strip(" ()"),
        why(decision, step),
        tuple(settings(decision, step)),
        tuple(losers_text(step)),
    )


def condition_line(item: ConditionRecord) -> str:
    """Write a condition with what was measured and how far that was from the limit."""
    said = item.text if item.holds else f"{item.text} (does not hold)"
    if item.value is None or item.template in INTERNAL:
        return said
    unit = f" {item.unit}" if item.unit != "1" else ""
    said += f": {number_text(item.value)}{unit}"
    if item.margin is None:
        return said
    side = "beyond the limit" if item.margin >= 0 else "short of it"
    return f"{said}, {number_text(abs(item.margin))}{unit} {side}"


def rules_fired(decision: Decision, answers: Answers) -> list[RuleFired]:
    """Return every rule that fired, by id and stage."""
    texts = answers.rules or {}
    found: dict[tuple[str, str], RuleFired] = {}
    for firing in decision.firings:
        key = firing.rule, firing.stage
        bound = tuple((alias, fact_text(record)) for alias, record in firing.bindings.items())
        conditions = tuple(condition_line(item) for item in firing.conditions)
        actions = tuple(item.text for item in firing.actions)
        known = found.get(key) or RuleFired(
            firing.rule,
            firing.name,
            firing.stage,
            texts.get(firing.rule, ""),
            firing.because,
            firing.references,
        )
        found[key] = replace(
            known,
            conditions=_joined(known.conditions, conditions),
            actions=_joined(known.actions, actions),
            bindings=_joined(known.bindings, (bound,)),
        )
    return [found[key] for key in sorted(found)]


def _joined(known: tuple[T, ...], more: tuple[T, ...]) -> tuple[T, ...]:
    """Return both, everything once."""
    return tuple(dict.fromkeys((*known, *more)))
