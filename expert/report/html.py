"""A decision record and the pictures of its run as one self-contained page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

from markupsafe import Markup

from expert.decision import Decision, TrialRecord
from expert.pages import render
from expert.report.answers import Answers, answer
from expert.report.graph import DecisionGraph, Drawing, Key, decision_graph, draw
from expert.report.pictures import PLOT_HEIGHT, PLOT_WIDTH, pair_pictures
from expert.report.rows import Choice, FactRow, RuleFired, choices, fact_rows, rules_fired
from expert.report.terrain import terrain
from expert.report.validity import disparity_pictures
from expert.report.verdict import verdict
from expert.report.words import fact_text, number_text
from modules.formats.viewer import viewer_script_hash


@dataclass(frozen=True)
class Bar:
    """A number with its share of the largest."""

    name: str
    value: float
    percent: float


@dataclass(frozen=True)
class TrialRow:
    """One trial with its score as a share of the best one."""

    trial: TrialRecord
    percent: float
    plan: str
    facts: tuple[str, ...]


@dataclass(frozen=True)
class PlanRow:
    """One slot of the plan that ran, with all parameters."""

    slot: str
    operator: str
    parameters: str


def _timings(decision: Decision) -> list[Bar]:
    spent = sorted(decision.timings_s.items(), key=lambda item: (-item[1], item[0]))
    longest = max((seconds for _, seconds in spent), default=0.0) or 1.0
    return [Bar(name, seconds, 100.0 * seconds / longest) for name, seconds in spent]


def _trials(decision: Decision) -> list[TrialRow]:
    best = max((trial.score or 0.0 for trial in decision.trials), default=0.0) or 1.0
    return [
        TrialRow(
            trial,
            100.0 * (trial.score or 0.0) / best,
            ", ".join(step.operator.partition(".")[2] for step in trial.plan.steps if step.operator != "none"),
            tuple(fact_text(fact) for fact in trial.product_facts),
        )
        for trial in decision.trials
    ]


def _plan(decision: Decision) -> list[PlanRow]:
    return [
        PlanRow(
            f"{stage}.{step.slot}",
            step.operator,
            ", ".join(f"{name}={number_text(value)}" for name, value in sorted(step.parameters.items())),
        )
        for stage, plan in decision.plans.items()
        for step in plan.steps
        if step.operator != "none"
    ]


def _about(
    graph: DecisionGraph,
    decision: Decision,
    facts: list[FactRow],
    rules: list[RuleFired],
    slots: list[Choice],
    answers: Answers,
) -> dict[Key, str]:
    """Return for every node which elements of the page tell more: those whose `data-id` this is."""
    found: dict[Key, str] = {}
    for row, number in zip(facts, _fact_numbers(facts), strict=True):
        found["fact", row.fact] = f"fact-{number}"
    for number, rule in enumerate(rules):
        found["rule", f"{rule.stage} {rule.rule}"] = f"rule-{number}"
    for number, finding in enumerate(decision.findings):
        found["finding", finding.name] = f"finding-{number}"
    places = {f"{slot.stage}.{slot.slot}": f"choice-{number}" for number, slot in enumerate(slots)}
    not_chosen = {item.operator: f"why-not-{number}" for number, item in enumerate(answers.not_chosen)}
    for node in graph.nodes:
        kind, name = node.key
        slot, _, operator = name.partition(" ")
        if kind == "choice":
            found[node.key] = places.get(slot, "")
        elif kind == "lost":
            found[node.key] = not_chosen.get(operator, places.get(slot, ""))
    return found


def _fact_numbers(facts: list[FactRow]) -> list[int]:
    """Return for each row the number of its fact."""
    numbers: dict[str, int] = {}
    return [numbers.setdefault(row.fact, len(numbers)) for row in facts]


def _drawn(
    decision: Decision, facts: list[FactRow], rules: list[RuleFired], slots: list[Choice], answers: Answers
) -> Drawing:
    graph = decision_graph(decision, answers.known)
    return draw(graph, _about(graph, decision, facts, rules, slots, answers))


def as_html(decision: Decision, files: Mapping[str, bytes], answers: Answers | None = None) -> str:
    """Return the report as one page that needs no other file and no network.

    Texts from files appear as text, never as markup, and the page allows no script but its own.

    Parameters
    ----------
    decision : Decision
    files : mapping of str to bytes
        Files of the run by name, as listed in `FILES`; what is missing is left out of the page.
    answers : Answers, optional
        Of `answer(decision)`, where they are known already.

    Returns
    -------
    str

    Raises
    ------
    ValueError
        A file is damaged.
    """
    answers = answers or answer(decision)
    facts, rules, slots = fact_rows(decision, answers), rules_fired(decision, answers), choices(decision)
    ground = terrain(files, decision.pair)
    return render(
        "expert.report",
        "report.html.j2",
        decision=decision,
        verdict=verdict(decision),
        pair=pair_pictures(files),
        disparity=disparity_pictures(files, _fields(decision, "rig")),
        terrain=ground,
        page_3d="" if ground is None else _quoted(ground.page),
        viewer_hash=viewer_script_hash(),
        linked_3d="terrain.html" in files,
        plot=(PLOT_WIDTH, PLOT_HEIGHT),
        facts=list(zip(facts, _fact_numbers(facts), strict=True)),
        choices=list(enumerate(slots)),
        rules=list(enumerate(rules)),
        graph=_drawn(decision, facts, rules, slots, answers),
        answers=answers,
        trials=_trials(decision),
        timings=_timings(decision),
        plan=_plan(decision),
        record=decision.to_json(),
    )


def _fields(decision: Decision, template: str) -> Mapping[str, object]:
    """Return the fields of a fact that there is one of."""
    return next((record.fields for record in decision.facts if record.template == template), {})


def _quoted(page: str) -> Markup:
    """Return a page as JSON text that may stand inside a script element, where nothing but `<` ends it."""
    return Markup(json.dumps(page).replace("<", "\\u003c"))
