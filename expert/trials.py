"""Trials of a stage: what one gave, the facts that count them, and their records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from expert.decision import FindingRecord, TrialRecord
from expert.facts import Fact, Failure, Planned, Severity, Vocabulary, to_fact
from expert.facts import Trial as TrialFact
from expert.firing import Firings
from expert.plan import NONE, Directives, StagePlan
from expert.recorder import fact_record
from expert.rules.model import Stage
from modules.operator import Operator
from modules.probe import FactModel

FAILED, GIVEN_UP = "operator-failed", "trial-given-up"  # findings that no rule names
Earlier = tuple[Firings, StagePlan, Mapping[Fact, str | None]]


@dataclass(frozen=True)
class Attempt:
    """One trial that gave a product."""

    number: int
    plan: StagePlan
    product: Any
    found: Mapping[Fact, str | None]  # facts about the product, and their probes
    assessed: Firings
    earlier: Mapping[Stage, Earlier]  # what the stages before had concluded, run and produced
    directives: Directives
    failed: frozenset[str]  # operators that had failed before it, and were excluded

    @property
    def score(self) -> float | None:
        """The no-reference score of the product, where a probe gives one."""
        return next((float(value) for fact in self.found if (value := fact.get("score")) is not None), None)


def trial_facts(stage: Stage, number: int, failed: frozenset[str]) -> dict[Fact, str | None]:
    """Return the facts that a trial of a stage starts from: its number, and the operators that failed before."""
    models: list[FactModel] = [TrialFact(number=number)]
    models += [Failure(operator=name, stage=stage) for name in sorted(failed)]
    return {to_fact(model): None for model in models}


def planned_steps(plan: StagePlan) -> list[Planned]:
    """Return what later stages know of a plan."""
    return [Planned(slot=f"{plan.stage}.{step.slot}", operator=step.operator) for step in plan.steps]


def trial_record(stage: Stage, attempt: Attempt, answer: str, words: Vocabulary) -> TrialRecord:
    """Record a trial that gave a product, and what was answered to it."""
    return TrialRecord(
        stage=stage,
        number=attempt.number,
        plan=attempt.plan,
        product_facts=tuple(fact_record(fact, probe, words) for fact, probe in sorted(attempt.found.items())),
        score=attempt.score,
        answer=answer or "accepted",
    )


def asks(extended: Directives, before: Directives) -> str:
    """Say what an assessment asked for beyond what was asked before."""
    asked = [
        f"try {candidate.operator} ({candidate.rule})"
        for slot, candidates in extended.candidates.items()
        for candidate in candidates[len(before.candidates.get(slot, ())) :]
    ]
    steps = extended.adjustments[len(before.adjustments) :]
    asked += [f"change {step.operator} {step.parameter} ({step.rule})" for step in steps]
    return "; ".join(asked)


def given_up(stage: Stage, needed_s: float, left_s: float, budget_s: float) -> FindingRecord:
    """Return the finding about a trial that is predicted not to fit the time budget."""
    sentence = (
        f"another trial of the {stage} was given up: it is predicted to take {needed_s:.2f} s, and about "
        f"{max(left_s, 0.0):.2f} s of the time budget of {budget_s:g} s are left"
    )
    return FindingRecord(name=GIVEN_UP, severity="minor", sentence=sentence, rules=(), stage=stage)


def failures(
    trials: Sequence[TrialRecord], plans: Mapping[Stage, StagePlan], operators: Mapping[str, Operator]
) -> list[FindingRecord]:
    """Return a finding per operator that failed: minor where its slot is filled all the same, else major."""
    kept = {record.stage for record in trials if record.kept}
    found = []
    for record in trials:
        if record.failure is None:
            continue
        failed, _, _ = record.failure.partition(":")
        plan = plans.get(record.stage)
        fills = NONE if plan is None else plan.operator_of(operators[failed].slot)
        answered = fills != NONE and (fills != failed or record.stage in kept)  # the same one with other parameters
        sentence = f"an operator could not do its work - {record.failure}"
        severity: Severity = "minor" if answered else "major"
        found.append(FindingRecord(name=FAILED, severity=severity, sentence=sentence, rules=(), stage=record.stage))
    return found
