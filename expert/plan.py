"""From firings to a plan: candidates for slots and parameters, settled by score, then priority, then id.

Never by firing order. Every loser is kept with the reason why it lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from expert.facts import Scalar
from expert.firing import Firing
from expert.rules.model import Adjust, Choose, Exclude, Repair, Rule, RuleBase, Set, Slot, Stage
from modules.operator import Operator, OperatorError, OperatorParams

NONE = "none"


class Record(BaseModel):
    """Base of the records that a decision is made of: frozen and closed."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Candidate(Record):
    """An operator that a rule proposed for a slot, or the slot's default."""

    operator: str
    rule: str | None
    score: float
    priority: int
    parameters: dict[str, Scalar] = {}
    lost_because: str | None = None


class Setting(Record):
    """A value that a rule gave to a parameter."""

    operator: str
    parameter: str
    value: Scalar
    rule: str
    score: float
    priority: int
    lost_because: str | None = None


class Step(Record):
    """One operator with its complete parameters, and who decided."""

    slot: str
    operator: str
    parameters: dict[str, Any]
    chosen_by: str | None
    set_by: dict[str, str] = {}
    losers: tuple[Candidate, ...] = ()
    lost_settings: tuple[Setting, ...] = ()


class StagePlan(Record):
    """The steps of one stage in the order they run; a step whose operator is `none` does nothing."""

    stage: Stage
    steps: tuple[Step, ...]

    def operator_of(self, slot: str) -> str:
        """Return the operator that fills a slot."""
        return next((step.operator for step in self.steps if step.slot == slot), NONE)

    def operators(self) -> tuple[str, ...]:
        """Return the operators that do something."""
        return tuple(step.operator for step in self.steps if step.operator != NONE)

    def configuration(self) -> tuple[tuple[str, str], ...]:
        """Return what would be run, comparable, to notice a configuration that was tried before."""
        return tuple((step.operator, repr(sorted(step.parameters.items()))) for step in self.steps)


class StepFailed(Exception):
    """An operator of a plan could not do its work."""

    def __init__(self, operator: str, reason: str) -> None:
        super().__init__(f"{operator}: {reason}")
        self.operator = operator


class PlanError(Exception):
    """A plan that cannot be run: an unknown operator, or parameters outside their range."""


class Adjustment(Record):
    """A bounded step of one parameter, asked for after a trial."""

    operator: str
    parameter: str
    rule: str
    by: float | None = None
    times: float | None = None
    at_least: float | None = None
    at_most: float | None = None

    def apply(self, value: Scalar) -> Scalar:
        """Return the changed value, kept within the bounds of the rule."""
        number = float(value) * (self.times if self.times is not None else 1.0) + (self.by or 0.0)
        if self.at_least is not None:
            number = max(number, self.at_least)
        if self.at_most is not None:
            number = min(number, self.at_most)
        return round(number) if isinstance(value, int) else number


class Directives(Record):
    """What assessments of earlier trials ask of the next one."""

    candidates: dict[str, tuple[Candidate, ...]] = {}
    adjustments: tuple[Adjustment, ...] = ()

    def of(self, stage: str) -> Directives:
        """Return what is asked of one stage."""
        return Directives(
            candidates={slot: items for slot, items in self.candidates.items() if slot.split(".", 1)[0] == stage},
            adjustments=tuple(step for step in self.adjustments if step.operator.split(".", 1)[0] == stage),
        )

    def touch(self, stages: Sequence[str]) -> bool:
        """Return whether anything is asked of one of these stages."""
        return any(self.of(stage) != Directives() for stage in stages)

    def joined(self, later: Directives) -> Directives:
        """Return what these and later directives ask for together, everything once."""
        merged = dict(self.candidates)
        for slot, candidates in later.candidates.items():
            known = merged.get(slot, ())
            merged[slot] = known + tuple(candidate for candidate in candidates if candidate not in known)
        return Directives(candidates=merged, adjustments=self.adjustments + later.adjustments)


def _slot_of(name: str, slot: str | None, stage: Stage, operators: Mapping[str, Operator]) -> str:
    if name == NONE:
        return f"{stage}.{slot}"
    operator = operators[name]
    return f"{operator.stage}.{operator.slot}"


def proposals(
    rules: Mapping[str, Rule], firings: Iterable[Firing], operators: Mapping[str, Operator], kinds: tuple[type, ...]
) -> dict[str, list[Candidate]]:
    """Collect the candidates that fired rules propose, by `stage.slot`."""
    found: dict[str, list[Candidate]] = {}
    for firing in firings:
        rule = rules[firing.rule]
        for resolved in firing.actions:
            action = rule.then[resolved.index]
            if not isinstance(action, kinds) or not isinstance(action, Choose | Repair):
                continue
            name = action.choose if isinstance(action, Choose) else action.repair
            candidate = Candidate(
                operator=name,
                rule=rule.id,
                score=action.score,
                priority=rule.priority,
                parameters=dict(resolved.values),
            )
            slot_candidates = found.setdefault(_slot_of(name, action.slot, rule.stage, operators), [])
            if candidate not in slot_candidates:
                slot_candidates.append(candidate)
    return found


def adjustments(rules: Mapping[str, Rule], firings: Iterable[Firing]) -> tuple[Adjustment, ...]:
    """Collect the adjustments that fired rules ask for, once each."""
    found: list[Adjustment] = []
    for firing in firings:
        rule = rules[firing.rule]
        for resolved in firing.actions:
            action = rule.then[resolved.index]
            if isinstance(action, Adjust):
                item = Adjustment(operator=action.adjust, rule=rule.id, **action.model_dump(exclude={"adjust"}))
                if item not in found:
                    found.append(item)
    return tuple(found)


def _exclusions(rules: Mapping[str, Rule], firings: Iterable[Firing]) -> dict[str, str]:
    excluded: dict[str, str] = {}
    for firing in firings:
        for resolved in firing.actions:
            action = rules[firing.rule].then[resolved.index]
            if isinstance(action, Exclude):
                excluded.setdefault(action.exclude, firing.rule)
    return excluded


def _settings(rules: Mapping[str, Rule], firings: Iterable[Firing]) -> list[Setting]:
    found: list[Setting] = []
    for firing in firings:
        rule = rules[firing.rule]
        for resolved in firing.actions:
            action = rule.then[resolved.index]
            if isinstance(action, Set):
                setting = Setting(
                    operator=action.set,
                    parameter=action.parameter,
                    value=dict(resolved.values)["to"],
                    rule=rule.id,
                    score=action.score,
                    priority=rule.priority,
                )
                if setting not in found:
                    found.append(setting)
    return found


def _rank(candidate: Candidate) -> tuple[float, int, str, str]:
    return -candidate.score, -candidate.priority, candidate.rule or "~", repr(sorted(candidate.parameters.items()))


def _settle_slot(
    stage: Stage, slot: Slot, candidates: Sequence[Candidate], excluded: Mapping[str, str]
) -> tuple[Candidate, tuple[Candidate, ...]]:
    default = Candidate(operator=slot.default, rule=None, score=0.0, priority=0, parameters=dict(slot.with_))
    winner: Candidate | None = None
    losers: list[Candidate] = []
    for candidate in [*sorted(candidates, key=_rank), default]:
        if candidate.rule is not None and candidate.operator in excluded:
            reason = f"excluded by {excluded[candidate.operator]}"
        elif winner is None:
            winner = candidate
            continue
        elif candidate.rule is None:
            reason = "the default loses to any rule's choice"
        elif candidate.score < winner.score:
            reason = f"score {candidate.score:g} is below {winner.score:g} of {winner.operator} ({winner.rule})"
        elif candidate.priority < winner.priority:
            reason = f"same score, priority {candidate.priority} is below {winner.priority} ({winner.rule})"
        else:
            reason = f"same score and priority, {winner.rule} comes first by id"
        losers.append(candidate.model_copy(update={"lost_because": reason}))
    if winner is None:
        raise PlanError(f"slot {stage}.{slot.slot} has no candidate")
    return winner, tuple(losers)


def _complete(
    winner: Candidate, settings: Sequence[Setting], steps: Sequence[Adjustment], operator: Operator
) -> tuple[dict[str, Any], dict[str, str], tuple[Setting, ...]]:
    """Settle every parameter: what the choice itself gives competes with what other rules set, on the same terms."""
    own = [
        Setting(
            operator=operator.name,
            parameter=name,
            value=value,
            rule=winner.rule or "default",
            score=winner.score,
            priority=winner.priority,
        )
        for name, value in winner.parameters.items()
    ]
    values: dict[str, Any] = {}
    set_by: dict[str, str] = {}
    lost: list[Setting] = []
    for setting in sorted([*own, *(s for s in settings if s.operator == operator.name)], key=_setting_rank):
        if setting.parameter in values:
            reason = f"{set_by[setting.parameter]} ranks first"
            lost.append(setting.model_copy(update={"lost_because": reason}))
        else:
            values[setting.parameter] = setting.value
            set_by[setting.parameter] = setting.rule
    params = _validated(operator, values)
    for step in steps:
        if step.operator == operator.name:
            values[step.parameter] = _within_range(operator, step, step.apply(getattr(params, step.parameter)))
            set_by[step.parameter] = step.rule
            params = _validated(operator, values)
    return params.model_dump(), set_by, tuple(lost)


def _within_range(operator: Operator, step: Adjustment, value: Scalar) -> Scalar:
    """Return the adjusted value, stopped at the range of the parameter: a step may not make a plan impossible."""
    for bound in operator.params.model_fields[step.parameter].metadata:
        low, high = getattr(bound, "ge", None), getattr(bound, "le", None)
        value = value if low is None else max(value, low)
        value = value if high is None else min(value, high)
    return value


def _setting_rank(setting: Setting) -> tuple[float, int, str, str]:
    return -setting.score, -setting.priority, setting.rule, repr(setting.value)


def _validated(operator: Operator, values: Mapping[str, Any]) -> OperatorParams:
    try:
        return operator.params(**values)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(str(part) for part in item['loc'])}: {item['msg']}, got {item['input']!r}"
            for item in error.errors()
        )
        raise PlanError(f"{operator.name}: {problems}") from error


def execute(
    plan: StagePlan,
    state: Any,
    operators: Mapping[str, Operator],
    around: Callable[[str], AbstractContextManager[Any]] = nullcontext,
) -> Any:
    """Run the steps of a plan on the state of its stage.

    Parameters
    ----------
    plan : StagePlan
    state : Views, Matching or Scene
    operators : mapping
        The catalog.
    around : callable, optional
        Gives a context for every step, by the name of its operator.

    Raises
    ------
    PlanError
        The catalog has no such operator, or it takes no such parameters.
    StepFailed
        An operator could not do its work.
    """
    for step in plan.steps:
        if step.operator == NONE:
            continue
        if step.operator not in operators:
            raise PlanError(f"slot {plan.stage}.{step.slot}: there is no operator {step.operator!r}")
        operator = operators[step.operator]
        params = _validated(operator, step.parameters)
        with around(step.operator):
            try:
                state = operator.function(state, params)
            except OperatorError as error:
                raise StepFailed(step.operator, str(error)) from error
    return state


def settle(
    base: RuleBase,
    stage: Stage,
    firings: Sequence[Firing],
    operators: Mapping[str, Operator],
    directives: Directives,
    failed: frozenset[str] = frozenset(),
) -> StagePlan:
    """Settle all conflicts and return the complete plan of one stage.

    Parameters
    ----------
    base : RuleBase
    stage : str
    firings : sequence of Firing
        What the stage's rules concluded.
    operators : mapping
        The catalog.
    directives : Directives
        What assessments of earlier trials ask for; settled together with the rules' own proposals.
    failed : frozenset of str
        Operators that failed on this pair; they are excluded.

    Raises
    ------
    PlanError
        A parameter is unknown or outside its range.
    """
    rules = base.by_id
    found = proposals(rules, firings, operators, (Choose,))
    excluded = {**_exclusions(rules, firings), **dict.fromkeys(failed, "a failure in an earlier trial")}
    settings = _settings(rules, firings)
    steps = []
    for slot in base.slots.get(stage, []):
        key = f"{stage}.{slot.slot}"
        candidates = [*found.get(key, []), *directives.candidates.get(key, ())]
        winner, losers = _settle_slot(stage, slot, candidates, excluded)
        if winner.operator == NONE:
            steps.append(Step(slot=slot.slot, operator=NONE, parameters={}, chosen_by=winner.rule, losers=losers))
            continue
        if winner.operator not in operators:
            raise PlanError(f"slot {key}: there is no operator {winner.operator!r}")
        parameters, set_by, lost = _complete(winner, settings, directives.adjustments, operators[winner.operator])
        steps.append(
            Step(
                slot=slot.slot,
                operator=winner.operator,
                parameters=parameters,
                chosen_by=winner.rule,
                set_by=set_by,
                losers=losers,
                lost_settings=lost,
            )
        )
    return StagePlan(stage=stage, steps=tuple(steps))
