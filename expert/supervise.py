"""The loop: measure, decide, run, assess, repair.

Data flows one way; the loop goes round by asserting facts about products. Every choice comes from rules; this module
only bounds the number of trials and keeps the best one.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from expert.costs import Costs
from expert.decision import FactRecord, FindingRecord, FiringRecord, TrialRecord
from expert.facts import Fact, to_fact
from expert.firing import Firings
from expert.knowledge import Knowledge
from expert.plan import Directives, StagePlan, StepFailed, adjustments, execute, proposals, settle
from expert.recorder import fact_record, finding_rank, finding_records, firing_records
from expert.rules.model import STAGES, Action, Exclude, Measure, Repair, Stage
from expert.trials import Attempt, asks, failures, given_up, planned_steps, trial_facts, trial_record
from modules.measurement.sample import Sample
from modules.operator import OperatorError
from modules.probe import FactModel, Probe, Subject

log = logging.getLogger(__name__)

MAX_TRIALS = 5  # per stage; the rules ask for fewer, by profile
MAX_MEASURING_ROUNDS = 8


Start = Callable[[Directives], Any]
Measured = dict[
    str, tuple[FactModel, ...] | OperatorError
]  # of one pair, by probe; an error where it could not measure


@dataclass
class Run:
    """The state of one pair on its way through the loop; made for it and dropped after it."""

    knowledge: Knowledge
    sample: Sample
    facts: dict[Fact, str | None]  # facts about the pair and the task, and the probe of each
    progress: Callable[[str], None] = field(default=lambda _: None)
    costs: Costs | None = None  # where a time budget is stated
    run_s: float = 0.0  # CPU time predicted for the plans that ran, where there are costs
    measured: set[str] = field(default_factory=set)
    memory: Measured = field(default_factory=dict)
    concluded: dict[Stage, Firings] = field(default_factory=dict)
    plans: dict[Stage, StagePlan] = field(default_factory=dict)
    product_facts: dict[Stage, Mapping[Fact, str | None]] = field(default_factory=dict)
    kept: dict[Stage, Attempt] = field(default_factory=dict)
    _made: dict[Any, Attempt] = field(default_factory=dict)  # what was run on request of a later stage
    trials: list[TrialRecord] = field(default_factory=list)
    timings_s: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    given_up: list[FindingRecord] = field(default_factory=list)  # trials that did not fit the time budget

    # Measuring

    @contextmanager
    def timed(self, what: str) -> Iterator[None]:
        """Add the time spent inside to `timings_s[what]`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.timings_s[what] = self.timings_s.get(what, 0.0) + time.perf_counter() - start

    def measure(self, probe: Probe) -> None:
        """Run one probe of the pair and add its facts; a probe that cannot measure adds none and is noted.

        What `memory` holds of the probe is used as it is.
        """
        self.measured.add(probe.name)
        if probe.name not in self.memory:
            with self.timed(probe.name):
                try:
                    self.memory[probe.name] = tuple(probe.function(self.sample))
                except OperatorError as error:
                    self.memory[probe.name] = error
        found = self.memory[probe.name]
        if isinstance(found, OperatorError):
            self.notes.append(f"{probe.name} could not measure: {found}")
        else:
            self.facts.update({to_fact(model): probe.name for model in found})

    def measure_cheap(self) -> None:
        """Run the probes that every pair gets, but for those that a rule leaves out for what the caller stated."""
        self.progress("measuring")
        left_out = self._left_out()
        for probe in self.knowledge.probes.values():
            if probe.subject == "pair" and probe.tier == "cheap" and probe.name not in left_out:
                self.measure(probe)

    def _left_out(self) -> set[str]:
        rules = self.knowledge.leaving_out
        if rules is None:
            return set()
        with self.timed("inference"):
            result = self.knowledge.engine.infer(rules, "measurement", self.known("measurement"))
        return {action.exclude for action in self._actions(result) if isinstance(action, Exclude)}

    def measure_product(self, probe: Probe, product: Any) -> list[Fact]:
        """Run one probe of a product and return its facts; one that cannot measure gives none and is noted."""
        models: Sequence[FactModel] = ()
        with self.timed(probe.name):
            try:
                models = probe.function(product)
            except OperatorError as error:
                self.notes.append(f"{probe.name} could not measure: {error}")
        return [to_fact(model) for model in models]

    # Inference

    def known(self, stage: Stage) -> dict[Fact, str | None]:
        """Return the facts a stage starts from: the pair's, and what the stages before it found, ran and produced."""
        facts = {**self.facts, **self.predicted()}
        for earlier in STAGES[: STAGES.index(stage)]:
            if earlier in self.concluded:
                facts.update({fact: None for fact in self.concluded[earlier].facts if fact.template == "finding"})
            facts.update(self.product_facts.get(earlier, {}))
            if earlier in self.plans:
                facts.update({to_fact(model): None for model in planned_steps(self.plans[earlier])})
        return facts

    def predicted(self) -> dict[Fact, str | None]:
        """Return the facts about the costs of steps; none where no time budget is stated."""
        return {} if self.costs is None else self.costs.facts(self.facts)

    def infer(self, stage: Stage, extra: Mapping[Fact, str | None] | None = None) -> Firings:
        """Infer one stage; measure what its rules ask for and infer again until nothing more is asked."""
        base = self.knowledge.rules.base
        for _ in range(MAX_MEASURING_ROUNDS):
            with self.timed("inference"):
                result = self.knowledge.engine.infer(base, stage, [*self.known(stage), *(extra or ())])
            asked = [self.knowledge.probes[name] for name in sorted(self._asked(result) - self.measured)]
            due = [probe for probe in asked if probe.subject == "pair"]
            if not due:
                break
            for probe in due:
                self.measure(probe)
        return result

    def assess(
        self,
        stage: Stage,
        extra: Mapping[Fact, str | None],
        subject: Subject | None,
        product: Any,
        planned: Firings,
    ) -> tuple[dict[Fact, str | None], Firings]:
        """Measure a product, cheaply and as rules ask, and infer what it means; return its facts and the firings.

        `planned` is what was inferred before the product was there; where nothing is found it still holds.
        """
        waiting = [probe for probe in self.knowledge.probes.values() if probe.subject == subject]
        found: dict[Fact, str | None] = {}
        result = planned
        while due := [probe for probe in waiting if probe.tier == "cheap" or probe.name in self._asked(result)]:
            new = {fact: probe.name for probe in due for fact in self.measure_product(probe, product)}
            waiting = [probe for probe in waiting if probe not in due]
            found.update(new)
            if new:
                result = self.infer(stage, {**extra, **found})
        return found, result

    def _asked(self, result: Firings) -> set[str]:
        """Return the probes that fired rules ask for."""
        return {action.measure for action in self._actions(result) if isinstance(action, Measure)}

    def _actions(self, result: Firings) -> list[Action]:
        rules = self.knowledge.rules.base.by_id
        return [rules[firing.rule].then[item.index] for firing in result.firings for item in firing.actions]

    def decide_measurement(self) -> None:
        """Measure the pair and infer what it means."""
        self.measure_cheap()
        self.concluded["measurement"] = self.infer("measurement")

    # Planning and running

    def plan(
        self,
        stage: Stage,
        directives: Directives | None = None,
        failed: frozenset[str] = frozenset(),
        number: int = 1,
    ) -> StagePlan:
        """Infer and settle a trial of one stage without running it; `failed` operators are facts, and excluded."""
        result = self.infer(stage, trial_facts(stage, number, failed))
        plan = self._settle(stage, result, directives or Directives(), failed)
        self.concluded[stage], self.plans[stage] = result, plan
        return plan

    def _settle(
        self, stage: Stage, result: Firings, directives: Directives, failed: frozenset[str] = frozenset()
    ) -> StagePlan:
        with self.timed("inference"):
            return settle(
                self.knowledge.rules.base, stage, result.firings, self.knowledge.operators, directives, failed
            )

    def execute(self, plan: StagePlan, state: Any) -> Any:
        """Run the steps of a plan on the state of its stage.

        Raises
        ------
        StepFailed
            An operator could not do its work.
        """
        if self.costs is not None:
            self.run_s += self.costs.of_plan(plan, self.facts)
        return execute(plan, state, self.knowledge.operators, self._around)

    @contextmanager
    def _around(self, operator: str) -> Iterator[None]:
        self.progress(operator)
        with self.timed(operator):
            yield

    def run_stage(self, stage: Stage, subject: Subject | None, start: Start) -> Any:
        """Run one stage until its product is accepted or the trials are used up; return the best product, or None.

        Parameters
        ----------
        stage : str
        subject : str or None
            Subject of the probes that measure the product.
        start : callable
            From directives to the state that the stage starts with; it runs earlier stages again where the directives
            ask for that.
        """
        earlier = STAGES[: STAGES.index(stage)]
        directives, failed = Directives(), frozenset[str]()
        tried: set[Any] = set()
        attempts: list[Attempt] = []
        for number in range(1, MAX_TRIALS + 1):
            again = self._again(earlier, directives, attempts[-1].directives if attempts else Directives())
            if again and not self._affords(*again, attempts[-1].plan):
                break
            try:
                state = start(directives)
            except StepFailed as error:
                self.notes.append(f"{stage} trial {number} ended in an earlier stage: {error}")
                break
            extra = trial_facts(stage, number, failed)
            result = self.infer(stage, extra)
            plan = self._settle(stage, result, directives, failed)
            configuration = (*(self.plans[s].configuration() for s in earlier if s in self.plans), plan.configuration())
            if configuration in tried:
                break
            tried.add(configuration)
            if attempts and not self._affords(plan):
                break
            try:
                product = self.execute(plan, state)
            except StepFailed as error:
                self.record_failure(plan, number, error)
                if any(error.operator in attempt.plan.operators() for attempt in attempts):
                    break  # it works, but not as the repair asked
                failed |= {error.operator}
                self.concluded[stage] = result
                continue
            found, assessed = self.assess(stage, extra, subject, product, result)
            before = {
                name: (self.concluded[name], self.plans[name], self.product_facts.get(name, {}))
                for name in earlier
                if name in self.plans
            }
            attempt = Attempt(number, plan, product, found, assessed, before, directives, failed)
            attempts.append(attempt)
            extended = self._extend(directives, attempt.assessed)
            self.trials.append(trial_record(stage, attempt, asks(extended, directives), self.knowledge.words))
            if extended == directives:
                break
            directives = extended
        return self._keep(stage, attempts)

    def _again(self, earlier: Sequence[Stage], directives: Directives, before: Directives) -> list[StagePlan]:
        """Return the plans that directives ask to run again: from the first earlier stage of which they ask more."""
        changed = (i for i, name in enumerate(earlier) if directives.of(name) != before.of(name))
        first = next(changed, len(earlier))
        return [self.plans[name] for name in earlier[first:] if name in self.plans]

    def _affords(self, *plans: StagePlan) -> bool:
        """Say whether plans, the last one of a further trial, are predicted to fit; what does not becomes a finding."""
        budget = next((f.numbers["time_budget_s"] for f in self.facts if "time_budget_s" in f.numbers), None)
        if self.costs is None or budget is None:
            return True
        dear = sum(self.costs.of_probe(name) for name in self.measured if self._dear(name))
        left = budget - self.costs.beside_plans() - dear - self.run_s
        needed = sum(self.costs.of_plan(plan, self.facts) for plan in plans)
        if needed > left:
            self.given_up.append(given_up(plans[-1].stage, needed, left, budget))
        return needed <= left

    def _dear(self, name: str) -> bool:
        return self.knowledge.probes[name].tier != "cheap"

    def record_failure(self, plan: StagePlan, number: int, error: StepFailed) -> None:
        """Note that an operator of this plan failed; it becomes a trial and a finding."""
        record = TrialRecord(stage=plan.stage, number=number, plan=plan, failure=str(error), answer="failed")
        self.trials.append(record)

    def _keep(self, stage: Stage, attempts: list[Attempt]) -> Any:
        if not attempts:
            return None
        faults = {attempt.number: self._faults(stage, attempt) for attempt in attempts}
        # Of equal scores the one that rules find less wrong with, and then the earlier one.
        best = max(attempts, key=lambda item: (item.score or 0.0, -len(faults[item.number]), -item.number))
        if all(attempt.score is None for attempt in attempts):
            # Nothing compares them, and the rules asked for the last one; what ruins the product is no repair.
            sound = [attempt for attempt in attempts if "critical" not in faults[attempt.number]]
            best = (sound or attempts)[-1]
        self.trials = [
            record.model_copy(update={"kept": True})
            if (record.stage, record.number) == (stage, best.number)
            else record
            for record in self.trials
        ]
        for name, (concluded, plan, found) in best.earlier.items():
            self.concluded[name], self.plans[name], self.product_facts[name] = concluded, plan, found
        self.concluded[stage], self.plans[stage], self.product_facts[stage] = best.assessed, best.plan, best.found
        self.kept[stage] = best
        return best.product

    def _faults(self, stage: Stage, attempt: Attempt) -> list[str]:
        """Return the severities of what rules found about a trial."""
        return [record.severity for record in finding_records(self.knowledge.rules.base, {stage: attempt.assessed})]

    def _extend(self, directives: Directives, assessed: Firings) -> Directives:
        found = proposals(self.knowledge.rules.base.by_id, assessed.firings, self.knowledge.operators, (Repair,))
        steps = adjustments(self.knowledge.rules.base.by_id, assessed.firings)
        asked = Directives(candidates={slot: tuple(items) for slot, items in found.items()}, adjustments=steps)
        return directives.joined(asked)

    def run_again(self, stage: Stage, subject: Subject | None, directives: Directives, start: Start) -> Any:
        """Run an earlier stage once more, as a later one asks, on top of what its own trials had asked for.

        What was run so before is not run again.

        Raises
        ------
        StepFailed
            An operator could not do its work.
        """
        kept = self.kept[stage]
        both = kept.directives.joined(directives)
        state = start(both)
        plan = self.plan(stage, both, kept.failed, kept.number)
        so_far = STAGES[: STAGES.index(stage) + 1]
        key = tuple(self.plans[name].configuration() for name in so_far if name in self.plans)
        if key not in self._made:
            product = self.execute(plan, state)
            extra = trial_facts(stage, kept.number, kept.failed)
            found, assessed = self.assess(stage, extra, subject, product, self.concluded[stage])
            self._made[key] = Attempt(kept.number, plan, product, found, assessed, {}, both, kept.failed)
        made = self._made[key]
        self.product_facts[stage], self.concluded[stage] = made.found, made.assessed
        return made.product

    # The record

    def findings(self) -> tuple[FindingRecord, ...]:
        """Return the findings, the most severe first."""
        derived = finding_records(self.knowledge.rules.base, self.concluded)
        failed = failures(self.trials, self.plans, self.knowledge.operators)
        return tuple(sorted([*derived, *failed, *self.given_up], key=finding_rank))

    def critical(self) -> bool:
        """Whether a finding says that the pair cannot be reconstructed."""
        return any(record.severity == "critical" for record in self.findings())

    def firing_records(self) -> tuple[FiringRecord, ...]:
        """Return all firings in canonical order, by stage."""
        probe_of = dict(self.facts)
        for found in self.product_facts.values():
            probe_of.update(found)
        base, words = self.knowledge.rules.base, self.knowledge.words
        return tuple(
            record
            for stage in STAGES
            if stage in self.concluded
            for record in firing_records(base, stage, self.concluded[stage], probe_of, words)
        )

    def fact_records(self) -> tuple[FactRecord, ...]:
        """Return all facts about the pair, the task and the products, in canonical order."""
        facts = {**self.facts, **self.predicted()}
        for found in self.product_facts.values():
            facts.update(found)
        ordered = sorted(facts.items(), key=lambda item: repr(item[0]))
        return tuple(fact_record(fact, probe, self.knowledge.words) for fact, probe in ordered)
