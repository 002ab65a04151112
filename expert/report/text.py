"""A decision record as text for a terminal, and the sections that text and Markdown share."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import dataclass

from expert.decision import Decision
from expert.report.answers import Answers, answer
from expert.report.rows import Choice, FactRow, choices, fact_rows, rules_fired
from expert.report.verdict import verdict
from expert.report.words import parameter_text, why

WIDTH = 120  # columns of an outline
SUMMARY = ("Findings", "Notes", "What was done, and why", "Trials")


@dataclass(frozen=True)
class Section:
    """A title and its lines; a line that belongs to the one before is indented by four."""

    title: str
    lines: tuple[str, ...]


def _steps(decision: Decision) -> Iterator[str]:
    for choice in choices(decision):
        if choice.operator != "none" or choice.losers:
            yield from _step(choice)


def _step(choice: Choice) -> Iterator[str]:
    parameters = f" ({choice.parameters})" if choice.parameters else ""
    yield f"{choice.stage}.{choice.slot}: {choice.operator}{parameters} - {choice.summary}"
    yield f"    because {choice.why}"
    for reason in choice.settings:
        yield f"    with {reason}"
    for loser in choice.losers:
        yield f"    rather than {loser}"


def fact_line(row: FactRow) -> str:
    """Write one field of a fact with its unit and the nearest limit of a rule."""
    value = f"{row.name} is {row.value}{' ' + row.unit if row.unit else ''} ({row.probe})"
    return f"{value}; nearest limit: {row.nearest}" if row.nearest else value


def _rules(decision: Decision, answers: Answers) -> Iterator[str]:
    for rule in rules_fired(decision, answers):
        yield f"{rule.rule} {rule.name} ({rule.stage}): {rule.because}"
        if rule.references:
            yield f"    after {'; '.join(rule.references)}"
        for line in rule.conditions:
            yield f"    when {line}"
        for line in rule.actions:
            yield f"    then {line}"


def _trials(decision: Decision) -> Iterator[str]:
    for trial in decision.trials:
        score = "no score" if trial.score is None else f"score {trial.score:.3f}"
        kept = ", kept" if trial.kept else ""
        outcome = trial.failure or trial.answer
        yield f"{trial.stage} trial {trial.number}: {score}{kept}; {outcome}"


def _why_not(answers: Answers) -> Iterator[str]:
    for item in answers.not_chosen:
        yield item.sentence
        for line in item.rules:
            yield f"    {line}"
    if answers.unanswered:
        yield answers.unanswered


def _record(decision: Decision) -> Iterator[str]:
    yield f"decision {decision.id}"
    yield f"rules {decision.rules_digest}"
    yield f"inputs {decision.inputs_digest}"
    yield f"profile {decision.profile}, engine {decision.engine}"
    for name, number in decision.versions.items():
        yield f"{name} {number}"


def _findings(decision: Decision) -> list[str]:
    return [f"{f.severity}: {f.sentence} ({', '.join(f.rules) or f.stage})" for f in decision.findings]


def sections(decision: Decision, answers: Answers) -> Iterator[Section]:
    """Yield everything that a report says after its verdict, except the facts that no rule fired on."""
    mattered = [fact_line(row) for row in fact_rows(decision, answers) if row.mattered]
    spent = sorted(decision.timings_s.items(), key=lambda item: (-item[1], item[0]))
    yield Section("Findings", tuple(_findings(decision)))
    yield Section("Notes", decision.notes)
    yield Section("What was done, and why", tuple(_steps(decision)))
    yield Section("Why not another operator?", tuple(_why_not(answers)))
    yield Section("Facts that mattered", tuple(mattered))
    yield Section("Rules that fired", tuple(_rules(decision, answers)))
    yield Section("Trials", tuple(_trials(decision)))
    yield Section("Time", tuple(f"{name}: {seconds:.3f} s" for name, seconds in spent))
    yield Section("Record", tuple(_record(decision)))


def as_text(decision: Decision, answers: Answers | None = None) -> str:
    """Return the whole report as plain text.

    Parameters
    ----------
    decision : Decision
    answers : Answers, optional
        Of `answer(decision)`, where they are known already.
    """
    answers = answers or answer(decision)
    lines = [f"{decision.pair}: {verdict(decision).text}"]
    for section in sections(decision, answers):
        if section.lines:
            lines += ["", section.title, *(f"  {line}" for line in section.lines)]
    return "\n".join(lines) + "\n"


def as_outline(decision: Decision) -> str:
    """Return what fits a screen: verdict, findings, the plan with who chose each operator, and the rules that fired."""
    told = verdict(decision)
    lines = [f"{decision.pair}:", f"  {told.wrong}", f"  {told.done}", f"  {told.trust}"]
    for title, found in (
        ("Findings", [f"  {line}" for line in _findings(decision)]),
        ("Plan", list(_plan(decision))),
        ("Rules that fired", list(_fired(decision))),
    ):
        lines += ["", title, *found] if found else []
    return "\n".join(lines) + "\n"


def _plan(decision: Decision) -> Iterator[str]:
    """Yield a line for each operator, and one for the rule that chose it."""
    for stage, plan in decision.plans.items():
        for step in plan.steps:
            if step.operator != "none":
                default = "" if step.chosen_by else ", the default"
                yield f"  {stage}.{step.slot}: {step.operator}{parameter_text(step)}{default}"
                if step.chosen_by:
                    yield "      " + textwrap.shorten(f"because {why(decision, step)}", WIDTH - 6, placeholder=" ...")


def _fired(decision: Decision) -> Iterator[str]:
    names = dict.fromkeys(f"{firing.rule} {firing.name}" for firing in decision.firings)
    text = ", ".join(name.replace(" ", "\0") for name in names)  # no line ends between an id and its name
    lines = textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)
    yield from (line.replace("\0", " ") for line in lines)


def as_summary(decision: Decision) -> str:
    """Return what a terminal shows after a run: the verdict, and the sections of `SUMMARY`."""
    told = verdict(decision)
    lines = [f"{decision.pair}:", f"  {told.wrong}", f"  {told.done}", f"  {told.trust}"]
    for section in sections(decision, Answers()):
        if section.lines and section.title in SUMMARY:
            lines += ["", section.title, *(f"  {line}" for line in section.lines)]
    return "\n".join(lines) + "\n"
