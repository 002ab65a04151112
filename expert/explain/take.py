"""What it would take to get another operator: the smallest change of facts that flips the choice."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from expert.decision import Decision
from expert.explain.model import Way, WhatItTakes
from expert.explain.record import ExplainError, check_digest, findings_in, proposes, unknown
from expert.explain.replan import Override, Replan, changes
from expert.facts import Fact, FieldInfo, Scalar
from expert.firing import Engine
from expert.plan import NONE, PlanError, Step
from expert.rules.checks.context import walk
from expert.rules.evaluate import SIGNIFICANT_SIGMAS, Evaluator, finding_of
from expert.rules.load import KnownRules
from expert.rules.model import STAGES, Action, Choose, Comparison, Exclude, Measure, Repair, Rule, Stage
from modules.catalog import operators, probes

MAX_PLANS = 1500  # plans tried for one question
MAX_WAYS = 3
FIXED = frozenset({"finding", "planned", "trial", "failure"})  # concluded or counted, not measured


@dataclass(frozen=True)
class _Move:
    """One field of one fact, moved just across a limit."""

    override: Override
    cost: float

    @property
    def place(self) -> tuple[object, ...]:
        return self.override.template, self.override.where, self.override.field


def what_would_it_take(decision: Decision, rules: KnownRules, engine: Engine, wanted: str) -> WhatItTakes:
    """Return the smallest change of one field of a fact, else of two, that gives a slot another operator.

    Parameters
    ----------
    decision : Decision
    rules : KnownRules
        The rules of the decision.
    engine : Engine
    wanted : str
        An operator (`matching.block_match`), or `stage.slot=operator`, where the operator may be `none`.

    Raises
    ------
    ExplainError
        There is no such operator or slot, or the rules are not those of the decision.

    Notes
    -----
    Only values at and just past the limits that rules compare with can change a choice of the rules, so only these are
    tried. Limits that are other fields are taken as recorded.
    """
    check_digest(decision, rules)
    stage, slot, operator = _goal(rules, wanted)
    replan = Replan(decision, rules, engine)
    now = _step(replan, (), stage, slot)
    if now is None:
        raise ExplainError(f"the recorded facts give no plan for {stage}")
    name = f"{stage}.{slot}"
    if now.operator == operator:
        return WhatItTakes(slot=name, operator=operator, now=now.operator, already=True)
    moves = sorted(_moves(replan, _relevant(rules, stage, slot)), key=lambda move: (move.cost, repr(move.override)))
    ways: list[Way] = []
    tried = 0
    for count in (1, 2):
        for combination in _combinations(moves, count):
            if tried == MAX_PLANS or len(ways) == MAX_WAYS:
                break
            tried += 1
            overrides = [move.override for move in combination]
            step = _step(replan, overrides, stage, slot)
            if step is not None and step.operator == operator:
                cost = float(f"{sum(move.cost for move in combination):.6g}")
                ways.append(Way(changes=changes(replan, overrides), cost=cost, chosen_by=step.chosen_by))
        if ways:
            break
    return WhatItTakes(
        slot=name,
        operator=operator,
        now=now.operator,
        ways=tuple(ways),
        tried=tried,
        complete=tried < MAX_PLANS,
        proposed_by=_proposers(rules, stage, slot, operator),
    )


def _proposers(rules: KnownRules, stage: Stage, slot: str, operator: str) -> tuple[str, ...]:
    """Return the rules that give an operator to a slot, and `the default` where that gives it."""
    found = {
        rule.id
        for rule in rules.base.rules
        for action in rule.then
        if isinstance(action, Choose | Repair)
        and proposes(action) == operator
        and (operator != NONE or (rule.stage, action.slot) == (stage, slot))
    }
    declared = next(item for item in rules.base.slots[stage] if item.slot == slot)
    return (*sorted(found), *(["the default"] if declared.default == operator else []))


def _goal(rules: KnownRules, wanted: str) -> tuple[Stage, str, str]:
    catalog = operators()
    place, equals, operator = wanted.rpartition("=")
    if not equals:
        if wanted not in catalog:
            raise unknown("operator", wanted, catalog)
        entry = catalog[wanted]
        place = f"{entry.stage}.{entry.slot}"
    if operator != NONE and operator not in catalog:
        raise unknown("operator", operator, [*catalog, NONE])
    slots = {f"{stage}.{slot.slot}": (stage, slot.slot) for stage, items in rules.base.slots.items() for slot in items}
    if place not in slots:
        raise unknown("slot", place, slots)
    if operator != NONE and f"{catalog[operator].stage}.{catalog[operator].slot}" != place:
        entry = catalog[operator]
        raise ExplainError(f"{operator} belongs to slot {entry.stage}.{entry.slot}, not {place}")
    return *slots[place], operator


def _step(replan: Replan, overrides: Sequence[Override], stage: Stage, slot: str) -> Step | None:
    try:
        plan = replan.run(overrides, until=stage).plans[stage]
    except PlanError:
        return None
    return next((step for step in plan.steps if step.slot == slot), None)


def _combinations(moves: Sequence[_Move], count: int) -> list[tuple[_Move, ...]]:
    found = [
        combination
        for combination in itertools.combinations(moves, count)
        if len({move.place for move in combination}) == count
    ]
    return sorted(found, key=lambda combination: sum(move.cost for move in combination))


def _relevant(rules: KnownRules, stage: Stage, slot: str) -> list[Rule]:
    """Return the rules that fill a slot or exclude from it, and those that derive or measure what these read."""
    catalog = operators()

    def touches(rule: Rule) -> bool:
        for action in rule.then:
            name = action.exclude if isinstance(action, Exclude) else proposes(action)
            if name == NONE and isinstance(action, Choose | Repair):
                if (rule.stage, action.slot) == (stage, slot):
                    return True
            elif name is not None and name in catalog and (catalog[name].stage, catalog[name].slot) == (stage, slot):
                return True
        return False

    reached = [rule for rule in rules.base.rules if STAGES.index(rule.stage) <= STAGES.index(stage)]
    found = [rule for rule in reached if touches(rule)]
    for rule in found:  # grows while it is read
        names = {item.finding for item in findings_in(rule.when)}
        templates = {item.fact for item, _, _ in walk(rule) if isinstance(item, Comparison)}
        for other in reached:
            if other not in found and any(_serves(action, names, templates) for action in other.then):
                found.append(other)
    return found


def _serves(action: Action, findings: set[str], templates: set[str]) -> bool:
    if isinstance(action, Measure):
        return any(model.template in templates for model in probes()[action.measure].templates)
    derived = finding_of(action)
    return derived is not None and (derived.get("name") in findings or "finding" in templates)


def _moves(replan: Replan, rules: Sequence[Rule]) -> Iterator[_Move]:
    """Yield every move that flips one comparison of one rule on one recorded fact."""
    evaluator = Evaluator(replan.words, replan.rules.base.thresholds)
    seen: set[Override] = set()
    by_template: dict[str, list[Fact]] = {}
    for fact in replan.facts:
        by_template.setdefault(fact.template, []).append(fact)
    for rule in rules:
        for comparison, _, _ in walk(rule):
            if not isinstance(comparison, Comparison) or comparison.field is None or comparison.fact in FIXED:
                continue
            info = replan.words[comparison.fact].fields[comparison.field]
            keys = replan.words[comparison.fact].keys
            if comparison.field in keys:
                continue
            for fact in by_template.get(comparison.fact, ()):
                others = {name: items[0] for name, items in by_template.items()}
                bindings = {**others, comparison.name: fact}
                where = tuple((key, str(fact.get(key))) for key in keys)
                for value in _flips(evaluator, comparison, bindings, info):
                    override = Override(fact.template, comparison.field, value, where)
                    if override not in seen and value != fact.get(comparison.field):
                        seen.add(override)
                        yield _Move(override, _cost(fact.get(comparison.field), value))


def _flips(
    evaluator: Evaluator, comparison: Comparison, bindings: dict[str, Fact], info: FieldInfo
) -> list[Scalar | None]:
    """Return the values nearest to the recorded one that make a comparison true where it is false, and vice versa."""
    fact = bindings[comparison.name]
    value, limit = evaluator.sides(comparison, bindings)
    held = evaluator.comparison(comparison, bindings)
    found = []
    for candidate in _candidates(comparison, value, limit, info, fact):
        changed = Override(fact.template, info.name, candidate).apply(fact)
        if evaluator.comparison(comparison, {**bindings, comparison.name: changed}) != held:
            found.append(candidate)
    if any(isinstance(item, int | float) and not isinstance(item, bool) for item in found) and value is not None:
        return [min(found, key=lambda item: _cost(value, item))]
    return found


def _candidates(
    comparison: Comparison, value: Scalar | None, limit: object, info: FieldInfo, fact: Fact
) -> list[Scalar | None]:
    if info.kind == "boolean":
        return [False, True]
    limits = list(limit) if isinstance(limit, tuple) else [limit]
    if info.kind == "text":
        return list(info.choices) or [item for item in limits if isinstance(item, str)]
    if comparison.op in ("present", "absent"):
        return [None]
    step = info.resolution or (1.0 if info.kind == "integer" else 1e-6)
    sigma = fact.get(info.sigma) if info.sigma else None
    reach = SIGNIFICANT_SIGMAS * float(sigma or 0.0) if comparison.op.startswith("significantly") else 0.0
    found: list[Scalar | None] = []
    for item in limits:
        if isinstance(item, bool | str) or not isinstance(item, int | float):
            continue
        for end in {item - reach, item + reach, *((-item,) if comparison.op.startswith("abs_") else ())}:
            grid = {math.floor(end / step), math.ceil(end / step), round(end / step)}
            for index in sorted({index + shift for index in grid for shift in (-1, 0, 1)}):
                number = round(index * step, 9) + 0.0
                if (info.ge is None or number >= info.ge) and (info.le is None or number <= info.le):
                    found.append(round(number) if info.kind == "integer" else number)
    return found


def _cost(before: Scalar | None, after: Scalar | None) -> float:
    if isinstance(before, bool | str | None) or isinstance(after, bool | str | None):
        return 1.0
    return abs(after - before) / max(abs(before), abs(after), 1e-9)
