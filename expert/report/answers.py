"""What the rules that a record carries explain about it, asked once for all renderings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from expert import explain
from expert.decision import Decision
from expert.report.words import known_words, short_title
from expert.rules.explain import sentence
from expert.rules.load import KnownRules


@dataclass(frozen=True)
class WhyNotAnswer:
    """Why an operator was not chosen, and its lines on the rules that would have chosen it."""

    operator: str
    sentence: str
    rules: tuple[str, ...]


@dataclass(frozen=True)
class Answers:
    """The explanations of a report.

    Attributes
    ----------
    not_chosen : tuple of WhyNotAnswer
        One for every operator without a slot.
    nearest : dict
        By fact and field: the limit of a rule that the value is nearest to.
    rules : dict
        By id of a rule that fired: what it says, as a sentence.
    known : KnownRules or None
        The rules that the record carries.
    unanswered : str
        Why there are no answers; empty where there are.
    """

    not_chosen: tuple[WhyNotAnswer, ...] = ()
    nearest: Mapping[str, str] | None = None
    rules: Mapping[str, str] | None = None
    known: KnownRules | None = None
    unanswered: str = ""


def answer(decision: Decision) -> Answers:
    """Ask the rules of the record; without them the report says why it cannot answer."""
    try:
        rules = explain.rules_of(decision)
        found = []
        for item in explain.not_chosen(decision, rules):
            _, *lines = item.text().splitlines()
            found.append(WhyNotAnswer(item.name, item.sentence, tuple(line.strip() for line in lines)))
        fields = explain.margins(decision, rules).fields
    except explain.ExplainError as error:
        return Answers(unanswered=str(error))
    fired = {firing.rule for firing in decision.firings}
    return Answers(
        tuple(found),
        {f"{short_title(item.fact)}.{item.field}": item.rules[0].text() for item in fields if item.rules},
        {
            rule.id: sentence(rule, known_words(), rules.base.thresholds)
            for rule in rules.base.rules
            if rule.id in fired
        },
        rules,
    )
