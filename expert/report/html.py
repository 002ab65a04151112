"""A decision record and the pictures of its run as one self-contained page."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from expert import explain
from expert.decision import Decision, FactRecord
from expert.facts import FieldInfo, Vocabulary, vocabulary
from expert.plan import Step
from expert.report.pictures import PLOT_HEIGHT, PLOT_WIDTH, gallery
from expert.report.text import fact_text, number_text, parameter_text, settings, verdict, why
from modules.catalog import operators, probes

if TYPE_CHECKING:
    from jinja2 import Template


@dataclass(frozen=True)
class FactRow:
    """One field of a fact; facts of one template are told apart by their keys, as in `histogram[left, red].mean_dn`."""

    name: str
    value: str
    unit: str
    limits: str
    meaning: str
    probe: str
    nearest: str  # the limit of a rule that the value is nearest to
    mattered: bool


@dataclass(frozen=True)
class Choice:
    """One slot of the plan: what fills it, why, and what lost."""

    slot: str
    operator: str
    summary: str
    parameters: str
    why: str
    settings: tuple[str, ...]
    losers: tuple[str, ...]


@dataclass(frozen=True)
class RuleFired:
    """One rule that fired in one stage, and on which facts."""

    rule: str
    name: str
    stage: str
    because: str
    bindings: tuple[tuple[tuple[str, str], ...], ...]


@dataclass(frozen=True)
class Bar:
    """A number with its share of the largest."""

    name: str
    value: float
    percent: float


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


def _fact_rows(decision: Decision, words: Vocabulary, nearest: Mapping[str, str]) -> Iterator[FactRow]:
    bound = [record for firing in decision.firings for record in firing.bindings.values()]
    for record in decision.facts:
        template = words.get(record.template)
        fields = template.fields if template else {}
        keys = template.keys if template else ()
        which = ", ".join(str(record.fields[key]) for key in keys if key in record.fields)
        title = f"{record.template}[{which}]" if which else record.template
        matters = _is_bound(record, bound)
        for name, value in record.fields.items():
            if name in keys:
                continue
            info = fields.get(name)
            unit = info.unit if info and info.unit != "1" else ""
            yield FactRow(
                f"{title}.{name}",
                number_text(value),
                unit,
                _limits(info),
                info.description if info else "",
                record.probe or "stated",
                nearest.get(f"{title}.{name}", ""),
                matters,
            )


def _is_bound(record: FactRecord, bound: list[FactRecord]) -> bool:
    return any(other.template == record.template and other.fields == record.fields for other in bound)


def _losers(step: Step) -> Iterator[str]:
    for loser in step.losers:
        yield f"{loser.operator} ({loser.rule or 'default'}): {loser.lost_because}"
    for setting in step.lost_settings:
        value = number_text(setting.value)
        yield f"{setting.parameter}={value} of {setting.operator} ({setting.rule}): {setting.lost_because}"


def _choices(decision: Decision) -> dict[str, list[Choice]]:
    catalog = operators()
    found: dict[str, list[Choice]] = {}
    for stage, plan in decision.plans.items():
        for step in plan.steps:
            summary = catalog[step.operator].summary if step.operator in catalog else "nothing is done in this slot"
            choice = Choice(
                step.slot,
                step.operator,
                summary,
                parameter_text(step).strip(" ()"),
                why(decision, step),
                tuple(settings(decision, step)),
                tuple(_losers(step)),
            )
            found.setdefault(stage, []).append(choice)
    return found


def _rules(decision: Decision) -> list[RuleFired]:
    found: dict[tuple[str, str], list[tuple[tuple[str, str], ...]]] = {}
    texts: dict[tuple[str, str], tuple[str, str]] = {}
    for firing in decision.firings:
        key = (firing.rule, firing.stage)
        texts[key] = firing.name, firing.because
        bound = tuple((alias, fact_text(record)) for alias, record in firing.bindings.items())
        groups = found.setdefault(key, [])
        if bound not in groups:
            groups.append(bound)
    return [
        RuleFired(rule, texts[rule, stage][0], stage, texts[rule, stage][1], tuple(bindings))
        for (rule, stage), bindings in sorted(found.items())
    ]


@dataclass(frozen=True)
class Answers:
    """What the rules that a record carries explain about it.

    Attributes
    ----------
    not_chosen : dict
        By operator not chosen: the answer to "why not?", and its lines on rules.
    nearest : dict
        By fact and field: the limit of a rule that the value is nearest to.
    unanswered : str
        Why there are no answers; empty where there are.
    """

    not_chosen: dict[str, tuple[str, tuple[str, ...]]]
    nearest: dict[str, str]
    unanswered: str = ""


def _answers(decision: Decision) -> Answers:
    """Ask the rules of the record; without them the page says why it cannot answer."""
    not_chosen = {}
    try:
        rules = explain.rules_of(decision)
        for name in sorted(operators()):
            answer = explain.why_not(decision, rules, name)
            if answer.outcome != "chosen":
                _, *lines = answer.text().splitlines()
                not_chosen[name] = answer.sentence, tuple(line.strip() for line in lines)
        fields = explain.margins(decision, rules).fields
    except explain.ExplainError as error:
        return Answers({}, {}, str(error))
    nearest = {f"{item.fact}.{item.field}": item.rules[0].text() for item in fields if item.rules}
    return Answers(not_chosen, nearest)


def _timings(decision: Decision) -> list[Bar]:
    spent = sorted(decision.timings_s.items(), key=lambda item: (-item[1], item[0]))
    longest = max((seconds for _, seconds in spent), default=0.0) or 1.0
    return [Bar(name, seconds, 100.0 * seconds / longest) for name, seconds in spent]


@cache
def _template() -> tuple[Template, str, str]:
    """Return the page's template, its style and its script."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("expert.report", "")
    environment = Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    environment.filters["number"] = number_text
    environment.filters["fact"] = fact_text
    style, script = (loader.get_source(environment, name)[0] for name in ("report.css", "report.js"))
    return environment.get_template("report.html.j2"), style, script


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"


def as_html(decision: Decision, images: Mapping[str, bytes]) -> str:
    """Return the report as one page that needs no other file and no network.

    Texts from files appear as text, never as markup, and the page allows no script but its own.

    Parameters
    ----------
    decision : Decision
    images : mapping of str to bytes
        Files of the run by name, as listed in `PICTURES`; what is missing is left out of the page.

    Returns
    -------
    str

    Raises
    ------
    ValueError
        A file is not an image.
    """
    from markupsafe import Markup

    template, style, script = _template()
    words = vocabulary(probes().values())
    answers = _answers(decision)
    return template.render(
        decision=decision,
        verdict=verdict(decision),
        pictures=gallery(images),
        plot=(PLOT_WIDTH, PLOT_HEIGHT),
        facts=sorted(_fact_rows(decision, words, answers.nearest), key=lambda row: row.name),
        choices=_choices(decision),
        rules=_rules(decision),
        not_chosen=answers.not_chosen,
        unanswered=answers.unanswered,
        timings=_timings(decision),
        record=decision.to_json(),
        style=Markup(style),
        script=Markup(script),
        script_hash=_hash(script),
    )
