"""What explanations read off a record: facts of a stage, units, sources of rules, and what is wrong with a request."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

from expert.decision import Decision, FactRecord
from expert.facts import Fact, Vocabulary, to_fact
from expert.facts import Failure as FailureFact
from expert.facts import Planned as PlannedFact
from expert.facts import Trial as TrialFact
from expert.plan import StagePlan
from expert.rules.load import KnownRules
from expert.rules.model import STAGES, Choose, FindingCondition, Repair, Stage
from expert.rules.problem import suggest
from modules.catalog import probes

PRODUCT_OF: dict[Stage, str] = {"matching": "disparity", "reconstruction": "terrain"}


class ExplainError(ValueError):
    """A question that cannot be answered: an unknown name, or rules that are not those of the record."""


def check_digest(decision: Decision, rules: KnownRules) -> None:
    """Refuse rules that are not those the decision was made with.

    Raises
    ------
    ExplainError
        The digests differ.
    """
    if decision.rules_digest != rules.digest:
        raise ExplainError(
            f"the decision was made with rules {decision.rules_digest[:16]}, these are {rules.digest[:16]}; "
            "give the rule files of that run with --rules, in the same order"
        )


def unknown(what: str, name: str, known: Iterable[str]) -> ExplainError:
    """Return the error for a name that does not exist, with the nearest one that does."""
    hint = suggest(name, list(known))
    return ExplainError(f"there is no {what} {name!r}" + (f"; {hint}" if hint else ""))


def fact_of(record: FactRecord) -> Fact:
    """Turn a record back into the fact."""
    return Fact.of(record.template, **record.fields)


def planned_facts(plan: StagePlan) -> list[Fact]:
    """Return the facts that say what a stage runs."""
    return [to_fact(PlannedFact(slot=f"{plan.stage}.{step.slot}", operator=step.operator)) for step in plan.steps]


def product_of(record: FactRecord) -> str:
    """Return whose fact it is: `pair`, or the product it was measured on."""
    probe = probes().get(record.probe or "")
    return "pair" if probe is None else str(probe.subject)


def facts_of_stage(decision: Decision, stage: Stage) -> list[Fact]:
    """Return all facts that the rules of a stage saw in the inference that was kept."""
    reached = STAGES[: STAGES.index(stage) + 1]
    seen = {"pair", *(PRODUCT_OF[name] for name in reached if name in PRODUCT_OF)}
    facts = {fact_of(record) for record in decision.facts if product_of(record) in seen}
    for finding in decision.findings:
        if finding.stage in reached and finding.rules:  # a failed operator is a finding that no rule derived
            facts.add(Fact.of("finding", name=finding.name, severity=finding.severity))
    for name in reached[:-1]:
        if name in decision.plans:
            facts.update(planned_facts(decision.plans[name]))
    if stage != "measurement":
        facts.add(to_fact(TrialFact(number=kept_trial(decision, stage))))
        facts.update(to_fact(FailureFact(operator=name, stage=stage)) for name in failed_operators(decision, stage))
    return sorted(facts, key=str)


def failed_operators(decision: Decision, stage: Stage) -> list[str]:
    """Return the operators that had failed in trials of a stage before the kept one, which goes without them."""
    mine = [trial for trial in decision.trials if trial.stage == stage]
    before = itertools.takewhile(lambda trial: not trial.kept, mine)
    return sorted({trial.failure.partition(":")[0] for trial in before if trial.failure is not None})


def kept_trial(decision: Decision, stage: Stage) -> int:
    """Return the number of the trial that was kept, 1 where nothing was run."""
    return next((trial.number for trial in decision.trials if trial.stage == stage and trial.kept), 1)


def unit_of(words: Vocabulary, template: str, field: str | None) -> str:
    """Return the unit of a field, `1` where it has none."""
    info = words[template].fields.get(field or "") if template in words else None
    return info.unit if info else "1"


def source_of(rules: KnownRules, rule: str) -> str:
    """Return where a rule is written, `file:line`."""
    file, line = rules.positions.get(rule, ("", 0))
    return f"{file}:{line}" if file else "unknown file"


def proposes(action: object) -> str | None:
    """Return the operator that an action proposes, if it proposes one."""
    if isinstance(action, Choose):
        return action.choose
    return action.repair if isinstance(action, Repair) else None


def findings_in(conditions: object) -> list[FindingCondition]:
    """Return every finding that conditions ask for, at any depth."""
    if isinstance(conditions, FindingCondition):
        return [conditions]
    if isinstance(conditions, list | tuple):
        return [found for item in conditions for found in findings_in(item)]
    parts = [getattr(conditions, name, None) for name in ("not_", "any_of", "exists", "for_all", "where", "then")]
    return [found for part in parts if part is not None for found in findings_in(part)]
