"""What would have been planned if facts had other values."""

from __future__ import annotations

from collections.abc import Mapping

from expert.decision import Decision
from expert.explain.model import Change, StepChange, WhatIf
from expert.explain.record import PRODUCT_OF, ExplainError, check_digest
from expert.explain.replan import Outcome, Override, Replan, changes
from expert.facts import Scalar
from expert.firing import Engine
from expert.plan import PlanError, Step
from expert.rules.load import KnownRules


def what_if(decision: Decision, rules: KnownRules, engine: Engine, overrides: Mapping[str, Scalar | None]) -> WhatIf:
    """Plan all stages again from the recorded facts, some with other values, and say what changes.

    Parameters
    ----------
    decision : Decision
    rules : KnownRules
        The rules of the decision.
    engine : Engine
    overrides : mapping of str to scalar or None
        `brightness.offset_dn`, or `noise[side=left].sigma_dn` for one of several facts; None for absent.

    Raises
    ------
    ExplainError
        A field is unknown, a value is not one it can have, or the rules are not those of the decision.
    """
    check_digest(decision, rules)
    replan = Replan(decision, rules, engine)
    wanted = [replan.parse(target, value) for target, value in overrides.items()]
    before = replan.run()
    try:
        after = replan.run(wanted)
    except PlanError as error:
        raise ExplainError(f"with these values no plan can be made: {error}") from error
    return WhatIf(
        changes=changes(replan, wanted),
        steps=step_changes(before, after),
        findings_gone=_names(before.findings - after.findings),
        findings_new=_names(after.findings - before.findings),
        fired_no_more=tuple(sorted(before.fired - after.fired)),
        fired_instead=tuple(sorted(after.fired - before.fired)),
        repairs_gone=tuple(sorted(before.repairs - after.repairs)),
        repairs_new=tuple(sorted(after.repairs - before.repairs)),
        notes=_notes(replan, wanted, before, after),
    )


def step_changes(before: Outcome, after: Outcome) -> tuple[StepChange, ...]:
    """Return the slots that differ between two outcomes."""
    found = []
    for stage, plan in after.plans.items():
        for old, new in zip(before.plans[stage].steps, plan.steps, strict=True):
            if (old.operator, old.parameters) != (new.operator, new.parameters):
                found.append(
                    StepChange(
                        slot=f"{stage}.{new.slot}",
                        before=old.operator,
                        after=new.operator,
                        parameters=_parameters(old, new),
                        before_by=old.chosen_by,
                        after_by=new.chosen_by,
                    )
                )
    return tuple(found)


def _parameters(old: Step, new: Step) -> tuple[Change, ...]:
    if old.operator != new.operator:
        return ()
    return tuple(
        Change(fact=new.operator, field=name, before=old.parameters.get(name), after=value)
        for name, value in new.parameters.items()
        if old.parameters.get(name) != value
    )


def _names(findings: frozenset[tuple[str, str]]) -> tuple[str, ...]:
    return tuple(f"{name} ({severity})" for name, severity in sorted(findings))


def _of_budgets(replan: Replan, wanted: list[Override]) -> list[str]:
    """Say what the record cannot answer about time: costs are predicted while deciding, and only where a budget is."""
    predicted = any(fact.template == "cost" for fact in replan.facts)
    task = {item.field for item in wanted if item.template == "task"}
    if "time_budget_s" in task and not predicted:
        return ["no costs were predicted without a time budget, so no rule about it can fire; decide again with one"]
    if predicted and (
        "machine_speed" in task or {item.template for item in wanted} & {"image_format", "disparity_range"}
    ):
        return ["the predicted costs were kept as recorded, though they follow from this; decide again to know"]
    return []


def _notes(replan: Replan, wanted: list[Override], before: Outcome, after: Outcome) -> tuple[str, ...]:
    notes = [
        f"the record has no fact {item.template}; one with only this field was assumed"
        for item in wanted
        if not any(item.applies(fact) for fact in replan.facts)
    ]
    notes += _of_budgets(replan, wanted)
    for stage, plan in before.plans.items():
        recorded = replan.decision.plans.get(stage)
        if recorded is not None and recorded.configuration() != plan.configuration():
            notes.append(f"trials of a later stage changed the plan of {stage}; the plan before them is compared")
    for name in sorted(after.asked - before.asked - replan.measured):
        notes.append(f"a rule would ask for {name}, which was not run, so its facts are unknown")
    for name in sorted(before.asked - after.asked):
        notes.append(f"no rule would ask for {name}, so its facts were left out")
    if any(severity == "critical" for _, severity in after.findings - before.findings):
        notes.append("a critical finding forbids the reconstruction")
    changed = {step.slot.partition(".")[0] for step in step_changes(before, after)}
    for stage, product in PRODUCT_OF.items():
        affected = changed & ({"correction", stage} if stage == "matching" else {"correction", "matching", stage})
        if affected and replan._product.get(product):
            notes.append(f"the facts about the {product} were kept as recorded, though another {product} would result")
    return tuple(notes)
