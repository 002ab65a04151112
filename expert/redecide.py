"""Which recorded decisions other rules would make differently; nothing is measured or run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from expert.decision import Decision
from expert.explain.record import fact_of
from expert.explain.replan import Outcome, Replan
from expert.facts import vocabulary
from expert.firing import Engine, RunawayRuleBase
from expert.plan import NONE, PlanError, StagePlan, Step
from expert.recorder import finding_rank, finding_records, firing_records
from expert.rules.load import KnownRules
from modules.catalog import probes


@dataclass(frozen=True)
class Redecision:
    """What changes about one recorded decision.

    Attributes
    ----------
    file : str
    pair : str
    changes : tuple of str
        One sentence per slot and finding that differs; empty when the decision stays.
    unknown : tuple of str
        Dearer probes that the new rules ask for and the record does not have, so that their facts are missing.
    """

    file: str
    pair: str
    changes: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()


def read_records(folder: Path) -> tuple[list[tuple[str, Decision]], list[str]]:
    """Read every decision record below a folder; return them by path, and a sentence per record that is broken.

    Other JSON files are passed over.
    """
    found: list[tuple[str, Decision]] = []
    problems: list[str] = []
    for path in sorted(folder.rglob("*.json")):
        try:
            text = path.read_text(encoding="utf-8")
            if path.name == "decision.json" or '"decision_id"' in text:
                found.append((str(path), Decision.from_json(text)))
        except (OSError, ValueError) as error:
            problems.append(f"{path}: {' '.join(str(error).split())}")
    return found, problems


def redecide(file: str, decision: Decision, old: KnownRules, new: KnownRules, engine: Engine) -> Redecision:
    """Plan one pair from its recorded facts with both rule bases and compare.

    Facts about products stay as they were recorded, though other operators would give other products.
    """
    before, after = _outcome(decision, old, engine), _outcome(decision, new, engine)
    if isinstance(before, str) or isinstance(after, str):
        same = before == after
        return Redecision(file, decision.pair, () if same else (f"{_said(before)} -> {_said(after)}",))
    measured = frozenset(record.probe for record in decision.facts)
    unknown = tuple(sorted(name for name in after.asked - before.asked if name not in measured))
    changes = (*plan_changes(before.plans, after.plans), *finding_changes(before.findings, after.findings))
    return Redecision(file, decision.pair, changes, unknown)


def redecided(decision: Decision, rules: KnownRules, engine: Engine) -> Decision:
    """Return the record that the recorded facts give; with the rules of the record it has the same canonical core.

    Raises
    ------
    PlanError
        The facts give a parameter outside its range.
    RunawayRuleBase
        There are more firings than the cap allows.
    """
    outcome = Replan(decision, rules, engine).run()
    words = vocabulary(probes().values())
    probe_of = {fact_of(record): record.probe for record in decision.facts}
    failures = [finding for finding in decision.findings if not finding.rules]
    findings = sorted([*finding_records(rules.base, outcome.concluded), *failures], key=finding_rank)
    firings = [
        record
        for stage, result in outcome.concluded.items()
        for record in firing_records(rules.base, stage, result, probe_of, words)
    ]
    made = {
        "rules_digest": rules.digest,
        "firings": tuple(firings),
        "findings": tuple(findings),
        "plans": dict(outcome.plans),
    }
    return decision.model_copy(update=made)


def _outcome(decision: Decision, rules: KnownRules, engine: Engine) -> Outcome | str:
    try:
        return Replan(decision, rules, engine).run()
    except (PlanError, RunawayRuleBase) as error:
        return str(error)


def _said(outcome: Outcome | str) -> str:
    return f"no plan ({outcome})" if isinstance(outcome, str) else "a plan"


def plan_changes(before: Mapping[Any, StagePlan], after: Mapping[Any, StagePlan]) -> Iterator[str]:
    """Say which slots are filled by another operator or with other parameters; a slot of one side only counts."""
    old, new = (
        {f"{stage}.{step.slot}": step for stage, plan in plans.items() for step in plan.steps}
        for plans in (before, after)
    )
    nothing = Step(slot="", operator=NONE, parameters={}, chosen_by=None)
    for slot in [*old, *(name for name in new if name not in old)]:
        one, two = old.get(slot, nothing), new.get(slot, nothing)
        if one.operator != two.operator:
            yield f"{slot}: {one.operator} ({_by(one)}) -> {two.operator} ({_by(two)})"
        elif one.parameters != two.parameters:
            names = [name for name in one.parameters if one.parameters[name] != two.parameters.get(name)]
            moved = ", ".join(f"{name} {one.parameters[name]} -> {two.parameters.get(name)}" for name in names)
            yield f"{slot}: {two.operator} with {moved}"


def _by(step: Step) -> str:
    return step.chosen_by or "default"


def finding_changes(before: frozenset[tuple[str, str]], after: frozenset[tuple[str, str]]) -> Iterator[str]:
    """Say which findings, each with its severity, are gone and which are new."""
    for title, names in (("gone", before - after), ("new", after - before)):
        for name, severity in sorted(names):
            yield f"finding {title}: {name} ({severity})"
