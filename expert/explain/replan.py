"""Plan all stages again from recorded facts, some of them with other values; no pixel is touched.

A probe that is run only when a rule asks gives its recorded facts when a rule asks again, and nothing otherwise.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from expert.decision import Decision
from expert.explain.model import Change
from expert.explain.record import (
    PRODUCT_OF,
    ExplainError,
    fact_of,
    kept_trial,
    planned_facts,
    product_of,
    unit_of,
    unknown,
)
from expert.facts import Fact, FieldInfo, Scalar, to_fact, vocabulary
from expert.facts import Failure as FailureFact
from expert.facts import Trial as TrialFact
from expert.firing import Engine, Firings
from expert.margins import label
from expert.plan import Directives, StagePlan, adjustments, proposals, settle
from expert.rules.load import KnownRules
from expert.rules.model import STAGES, Measure, Repair, Stage
from modules.catalog import operators, probes

MAX_MEASURING_ROUNDS = 8  # as in the loop
_TARGET = re.compile(r"(?P<template>[a-z_0-9]+)(?:\[(?P<where>[^\]]*)\])?\.(?P<field>[a-z_0-9]+)")


@dataclass(frozen=True)
class Override:
    """A field of some facts that is assumed to have another value; None means absent."""

    template: str
    field: str
    value: Scalar | None
    where: tuple[tuple[str, str], ...] = ()

    def applies(self, fact: Fact) -> bool:
        """Say whether it speaks of a fact."""
        return fact.template == self.template and all(str(fact.get(name)) == value for name, value in self.where)

    def apply(self, fact: Fact) -> Fact:
        """Return the fact with the assumed value."""
        return Fact.of(fact.template, **{**fact.as_dict(), self.field: self.value})


@dataclass(frozen=True)
class Outcome:
    """What the stages concluded and planned."""

    plans: dict[Stage, StagePlan] = field(default_factory=dict)
    findings: frozenset[tuple[str, str]] = frozenset()
    fired: frozenset[str] = frozenset()
    asked: frozenset[str] = frozenset()  # dearer probes
    repairs: frozenset[str] = frozenset()  # what the assessment of the products asks of the next trial
    concluded: dict[Stage, Firings] = field(default_factory=dict)


class Replan:
    """Plans the stages of one decision again.

    Parameters
    ----------
    decision : Decision
    rules : KnownRules
        The rules of the decision.
    engine : Engine
        Any engine; all agree.
    """

    def __init__(self, decision: Decision, rules: KnownRules, engine: Engine) -> None:
        self.decision, self.rules, self.engine = decision, rules, engine
        self.words = vocabulary(probes().values())
        self._rules = rules.base.by_id
        self._cheap: list[Fact] = []
        self._dear: dict[str, list[Fact]] = {}
        self._product: dict[str, list[Fact]] = {}
        self._known: dict[tuple[Stage, frozenset[Fact]], Firings] = {}
        for record in decision.facts:
            probe = probes().get(record.probe or "")
            subject = product_of(record)
            if subject != "pair":
                self._product.setdefault(subject, []).append(fact_of(record))
            elif probe is not None and probe.tier != "cheap":
                self._dear.setdefault(probe.name, []).append(fact_of(record))
            else:
                self._cheap.append(fact_of(record))

    @property
    def facts(self) -> list[Fact]:
        """All recorded facts."""
        groups = [self._cheap, *self._dear.values(), *self._product.values()]
        return [fact for group in groups for fact in group]

    @property
    def measured(self) -> frozenset[str]:
        """The dearer probes that were run."""
        return frozenset(self._dear)

    def infer(self, stage: Stage, facts: Iterable[Fact]) -> Firings:
        """Infer one stage, once per set of facts."""
        key = stage, frozenset(facts)
        if key not in self._known:
            self._known[key] = self.engine.infer(self.rules.base, stage, sorted(key[1], key=str))
        return self._known[key]

    def run(self, overrides: Sequence[Override] = (), until: Stage = "reconstruction") -> Outcome:
        """Plan every stage up to one.

        Raises
        ------
        PlanError
            The facts give a parameter outside its range.
        """
        tried = [trial.stage for trial in self.decision.trials if trial.number > 1]
        last = max([until, *tried], key=STAGES.index)
        course = _Course(self, overrides)
        course.go_to(last)
        if course.reaches_back():  # a later stage asked for something of an earlier one: start again with its wishes
            course = _Course(self, overrides, course.wanted)
            course.go_to(last)
        return Outcome(
            course.plans,
            frozenset(course.findings),
            frozenset(course.fired),
            frozenset(course.asked),
            frozenset(course.repairs),
            course.concluded,
        )

    def asked(self, result: Firings) -> set[str]:
        """Return the probes that fired rules ask for."""
        actions = [self._rules[firing.rule].then[item.index] for firing in result.firings for item in firing.actions]
        return {action.measure for action in actions if isinstance(action, Measure)}

    def directives(self, before: Directives, result: Firings) -> Directives:
        """Add what an assessment asks of the next trial."""
        merged = dict(before.candidates)
        for slot, found in proposals(self._rules, result.firings, operators(), (Repair,)).items():
            known = merged.get(slot, ())
            merged[slot] = known + tuple(item for item in found if item not in known)
        return Directives(candidates=merged, adjustments=before.adjustments + adjustments(self._rules, result.firings))

    def parse(self, target: str, value: Scalar | None) -> Override:
        """Read `template.field` or `template[key=value].field`, and check the value against the vocabulary.

        Raises
        ------
        ExplainError
            There is no such field, or the value is not one it can have.
        """
        match = _TARGET.fullmatch(target.strip())
        if match is None:
            raise ExplainError(f"{target!r} is not FACT.FIELD, e.g. brightness.offset_dn or noise[side=left].sigma_dn")
        template, name = match["template"], match["field"]
        if template not in self.words:
            raise unknown("fact", template, self.words)
        fields = self.words[template].fields
        if name not in fields:
            raise unknown(f"field of {template}", name, fields)
        where = []
        for part in filter(None, (match["where"] or "").split(",")):
            key, _, wanted = part.partition("=")
            if key.strip() not in fields:
                raise unknown(f"field of {template}", key.strip(), fields)
            where.append((key.strip(), wanted.strip()))
        return Override(template, name, checked(fields[name], target, value), tuple(where))


class _Course:
    """One way through the stages."""

    def __init__(
        self, replan: Replan, overrides: Sequence[Override], known: Mapping[Stage, Directives] | None = None
    ) -> None:
        self.replan, self.overrides = replan, overrides
        self.known = known or {}  # what the trials of stages ask for, as far as it is known from an earlier course
        self.wanted: dict[Stage, Directives] = {}
        self.facts: set[Fact] = set(self.changed(replan._cheap))
        for item in overrides:
            if not any(item.applies(fact) for fact in replan.facts):
                self.facts.add(Fact.of(item.template, **{**dict(item.where), item.field: item.value}))
        self.plans: dict[Stage, StagePlan] = {}
        self.concluded: dict[Stage, Firings] = {}
        self.findings: set[tuple[str, str]] = set()
        self.fired: set[str] = set()
        self.asked: set[str] = set()
        self.repairs: set[str] = set()

    def changed(self, facts: Iterable[Fact]) -> list[Fact]:
        result = list(facts)
        for item in self.overrides:
            result = [item.apply(fact) if item.applies(fact) else fact for fact in result]
        return result

    def infer(self, stage: Stage, extra: Sequence[Fact] = ()) -> Firings:
        replan = self.replan
        for _ in range(MAX_MEASURING_ROUNDS):
            result = replan.infer(stage, [*self.facts, *extra])
            new = replan.asked(result) - self.asked
            if not new:
                break
            self.asked |= new
            for name in new:
                self.facts.update(self.changed(replan._dear.get(name, ())))
        return result

    def go_to(self, last: Stage) -> None:
        """Go through the stages up to one."""
        for stage in STAGES[: STAGES.index(last) + 1]:
            self.go(stage)

    def reaches_back(self) -> bool:
        """Say whether trials of a stage asked for something of an earlier one that this course did not know."""
        return any(
            asked.of(earlier) != self.known.get(stage, Directives()).of(earlier)
            for stage, asked in self.wanted.items()
            for earlier in STAGES[: STAGES.index(stage)]
        )

    def go(self, stage: Stage) -> None:
        """Infer and settle one stage, and assess its product where the record has one."""
        replan = self.replan
        if stage == "measurement":
            self.conclude(stage, self.infer(stage))
            return
        wanted, failed = self.wishes(stage)
        self.wanted[stage] = wanted = self.known.get(stage, wanted)
        directives = wanted
        for later in STAGES[STAGES.index(stage) + 1 :]:
            directives = directives.joined(self.known.get(later, Directives()))
        product = self.changed(self.product(stage))
        extra = [to_fact(TrialFact(number=kept_trial(replan.decision, stage)))]
        extra += [to_fact(FailureFact(operator=name, stage=stage)) for name in sorted(failed)]
        result = self.infer(stage, extra)
        plan = settle(replan.rules.base, stage, result.firings, operators(), directives, failed)
        if product:
            result = self.infer(stage, [*extra, *product])
            self.repairs |= _wishes(replan.directives(Directives(), result))
        self.plans[stage] = plan
        self.conclude(stage, result)
        self.facts.update([*product, *planned_facts(plan)])

    def product(self, stage: Stage) -> list[Fact]:
        """Return the recorded facts about the product of a stage: of its own trials, or of a later one's that asked."""
        asked = any(
            items.of(name) != Directives()
            for later, items in self.known.items()
            if STAGES.index(later) > STAGES.index(stage)
            for name in STAGES[: STAGES.index(stage) + 1]
        )
        kept = next((trial for trial in self.replan.decision.trials if trial.stage == stage and trial.kept), None)
        if kept is not None and not asked:
            return [fact_of(record) for record in kept.product_facts]
        return self.replan._product.get(PRODUCT_OF.get(stage, ""), [])

    def wishes(self, stage: Stage) -> tuple[Directives, frozenset[str]]:
        """Return what the trials before the kept one asked for, and what failed in them."""
        directives, failed = Directives(), frozenset[str]()
        mine = [trial for trial in self.replan.decision.trials if trial.stage == stage]
        kept = next((trial.number for trial in mine if trial.kept), len(mine) + 1)
        for trial in mine:
            if trial.number >= kept:
                continue
            if trial.failure is not None:
                failed |= {trial.failure.partition(":")[0]}
                continue
            extra = [to_fact(TrialFact(number=trial.number))]
            extra += [to_fact(FailureFact(operator=name, stage=stage)) for name in sorted(failed)]
            found = self.changed(fact_of(record) for record in trial.product_facts)
            directives = self.replan.directives(directives, self.infer(stage, [*extra, *found]))
        return directives, failed

    def conclude(self, stage: Stage, result: Firings) -> None:
        self.concluded[stage] = result
        for fact in result.facts:
            if fact.template == "finding":
                self.facts.add(fact)
                self.findings.add((str(fact.get("name")), str(fact.get("severity"))))
        self.fired |= {firing.rule for firing in result.firings}


def _wishes(directives: Directives) -> set[str]:
    candidates = [item for items in directives.candidates.values() for item in items]
    return {f"{item.operator} ({item.rule})" for item in candidates} | {
        f"another {step.parameter} of {step.operator} ({step.rule})" for step in directives.adjustments
    }


def checked(info: FieldInfo, target: str, value: Any) -> Scalar | None:
    """Turn a value, or its text, into what the field can hold.

    Raises
    ------
    ExplainError
        It cannot hold that.
    """
    if value is None or value == "absent":
        return None
    unit = "" if info.unit == "1" else f" {info.unit}"
    if info.kind == "boolean":
        if str(value).lower() not in ("true", "false"):
            raise ExplainError(f"{target} is true or false, not {value!r}")
        return str(value).lower() == "true"
    if info.kind == "text":
        if info.choices and str(value) not in info.choices:
            raise ExplainError(f"{target} is one of {', '.join(info.choices)}, not {value!r}")
        return str(value)
    try:
        result = float(value)
    except (TypeError, ValueError) as error:
        raise ExplainError(f"{target} is a number{unit and ' in' + unit}, not {value!r}") from error
    low, high = info.ge, info.le
    if result != result or (low is not None and result < low) or (high is not None and result > high):
        raise ExplainError(f"{target} is between {low} and {high}{unit}, not {value!r}")
    if info.kind == "integer":
        return round(result)
    step = info.resolution or 1e-6
    return round(round(result / step) * step, 9) + 0.0


def changes(replan: Replan, overrides: Sequence[Override]) -> tuple[Change, ...]:
    """Return which recorded fields the overrides change, and from what."""
    found = []
    for item in overrides:
        facts = [fact for fact in replan.facts if item.applies(fact)]
        for fact in facts or [Fact.of(item.template, **dict(item.where))]:
            found.append(
                Change(
                    fact=label(fact, replan.words) if facts else item.template,
                    field=item.field,
                    before=fact.get(item.field),
                    after=item.value,
                    unit=unit_of(replan.words, item.template, item.field),
                )
            )
    return tuple(found)
