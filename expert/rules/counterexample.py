"""Facts on which two rule bases conclude differently, found from the cases and the limits of the rules that changed."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from expert.facts import SEVERITIES, Fact, FieldInfo, Scalar, Vocabulary
from expert.firing import Engine
from expert.rules.checks.context import operands_in, parameters_of, thresholds_in, walk
from expert.rules.evaluate import Evaluator
from expert.rules.explain import action_text
from expert.rules.model import Comparison, FieldRef, FindingCondition, Rule, RuleBase

MAX_TRIED = 4000  # sets of facts per rule


@dataclass(frozen=True)
class Counterexample:
    """Facts on which one rule does something else than before.

    Attributes
    ----------
    rule : str
    facts : tuple of Fact
    before, after : tuple of str
        What the rule does there, in words; empty where it stays quiet.
    """

    rule: str
    facts: tuple[Fact, ...]
    before: tuple[str, ...]
    after: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """Return it as plain data for JSON."""
        facts = [{"fact": fact.template, **fact.as_dict()} for fact in self.facts]
        return {"rule": self.rule, "facts": facts, "before": self.before, "after": self.after}

    def __str__(self) -> str:
        """Write it as one sentence."""
        given = "; ".join(_given(fact) for fact in self.facts) or "no facts"
        old, new = (", and ".join(items) or "stays quiet" for items in (self.before, self.after))
        return f"e.g. {self.rule}, given {given}: {old} -> {new}"


def _given(fact: Fact) -> str:
    values = fact.as_dict()
    if fact.template == "finding":
        return f"the {values['severity']} finding {values['name']}"
    return f"{fact.template} " + ", ".join(f"{name} {value}" for name, value in values.items())


def counterexamples(
    old: RuleBase,
    new: RuleBase,
    vocabulary: Vocabulary,
    engine: Engine,
    given: Mapping[str, Sequence[frozenset[Fact]]],
) -> list[Counterexample]:
    """Return for each rule that is not the same in both facts on which it does something else, if some are found.

    Parameters
    ----------
    old, new : RuleBase
    vocabulary : mapping
    engine : Engine
        Any engine; all agree.
    given : mapping from rule id to sets of facts
        Where to begin, for instance the facts of the cases of each rule.
    """
    before, after = old.by_id, new.by_id
    shared = {*old.thresholds, *new.thresholds}
    moved = {name for name in shared if old.thresholds.get(name) != new.thresholds.get(name)}
    found = []
    for name in sorted({*before, *after}):
        sides = [(base, rules.get(name)) for base, rules in ((old, before), (new, after))]
        if before.get(name) == after.get(name) and not thresholds_in(after[name]) & moved:
            continue
        tried = _candidates(sides, vocabulary, given.get(name, ()))
        alone = [(base.model_copy(update={"rules": [rule] if rule else []}), rule) for base, rule in sides]
        for facts in itertools.islice(tried, MAX_TRIED):
            one, two = (_does(base, rule, engine, facts) for base, rule in alone)
            if one != two:
                found.append(Counterexample(name, tuple(sorted(facts)), one, two))
                break
    return found


def _does(base: RuleBase, rule: Rule | None, engine: Engine, facts: Iterable[Fact]) -> tuple[str, ...]:
    """Return what the only rule of a base does with facts, in words with the values it comes to."""
    if rule is None:
        return ()
    firings = engine.infer(base, rule.stage, facts).firings
    return tuple(
        action_text(_resolved(rule.then[item.index], dict(item.values)), base.thresholds)
        for firing in firings
        for item in firing.actions
    )


def _resolved(action: Any, values: dict[str, Scalar]) -> Any:
    """Return an action with the values that its operands came to."""
    if not values:
        return action
    return action.model_copy(update={"to": values["to"]} if "to" in values else {"with_": values})


def _candidates(
    sides: Sequence[tuple[RuleBase, Rule | None]], vocabulary: Vocabulary, given: Sequence[frozenset[Fact]]
) -> Iterator[frozenset[Fact]]:
    """Yield sets of facts: those given, one made up, and each of them with values moved to and across the limits."""
    starts = [*given, _made_up(sides, vocabulary)]
    yield from starts
    places = [place for base, rule in sides if rule for place in _places(base, rule, vocabulary)]
    for facts in starts:
        for place in places:
            yield from _moves(facts, *place)
    for facts in starts:
        for one, two in itertools.combinations(places, 2):
            for first in _moves(facts, *one):
                yield from _moves(first, *two)


Place = tuple[str, str, tuple[Scalar, ...]]


def _places(base: RuleBase, rule: Rule, vocabulary: Vocabulary) -> Iterator[Place]:
    """Yield template, field and values at, below and above every constant limit of a rule."""
    evaluator = Evaluator(vocabulary, base.thresholds)
    for condition, _, _ in walk(rule):
        if not isinstance(condition, Comparison) or condition.field is None:
            continue
        template = vocabulary.get(condition.fact)
        info = template.fields.get(condition.field) if template else None
        if info is not None:
            _, limit = evaluator.sides(condition, {condition.name: Fact.of(condition.fact)})
            limits = limit if isinstance(limit, tuple) else () if limit is None else (limit,)
            yield condition.fact, condition.field, tuple(_around(info, limits))


def _around(info: FieldInfo, limits: Iterable[Scalar]) -> Iterator[Scalar]:
    if info.kind == "boolean":
        yield from (True, False)
    elif info.kind == "text":
        yield from (*limits, *info.choices, "something-else")
    else:
        for limit in limits:
            if isinstance(limit, bool | str):
                continue
            step = 1 if info.kind == "integer" else info.resolution or max(abs(limit), 1.0) * 1e-3
            for value in (limit, limit - step, limit + step, limit * 1.1, limit * 0.9, -limit, -limit - step):
                number = round(value) if info.kind == "integer" else float(f"{value:.9g}")
                if (info.ge is None or number >= info.ge) and (info.le is None or number <= info.le):
                    yield number


def _moves(facts: frozenset[Fact], template: str, field: str, values: Sequence[Scalar]) -> Iterator[frozenset[Fact]]:
    for fact in sorted(facts):
        if fact.template == template:
            for value in values:
                yield facts - {fact} | {Fact.of(template, **{**fact.as_dict(), field: value})}


def _calculated_with(rule: Rule) -> Iterator[tuple[str, str]]:
    """Yield template and field of every value that the actions of a rule calculate with."""
    bound = {item.name: item.fact for item in rule.when if isinstance(item, Comparison)}
    for action in rule.then:
        for operand, path in parameters_of(action, ()):
            for use in operands_in(operand, path, False):
                if isinstance(use.operand, FieldRef):
                    alias, _, field = use.operand.field.partition(".")
                    yield bound[alias], field


def _made_up(sides: Sequence[tuple[RuleBase, Rule | None]], vocabulary: Vocabulary) -> frozenset[Fact]:
    """Return one fact of every template the rules speak of, at their limits, and the findings they ask for."""
    values: dict[str, dict[str, Scalar]] = {}
    facts: set[Fact] = set()
    for base, rule in sides:
        if rule is None:
            continue
        for condition, _, _ in walk(rule):
            if isinstance(condition, FindingCondition):
                facts.add(Fact.of("finding", name=condition.finding, severity=SEVERITIES[-1]))
            elif isinstance(condition, Comparison) and condition.fact != "finding":
                values.setdefault(condition.fact, {})
        for template, field, near in _places(base, rule, vocabulary):
            if near and template != "finding":
                values.setdefault(template, {}).setdefault(field, near[0])
        for template, field in _calculated_with(rule):
            info = vocabulary[template].fields[field]
            if info.kind in ("number", "integer"):
                low, high = (0.0 if info.ge is None else info.ge), (100.0 if info.le is None else info.le)
                value = low + 0.6 * (high - low)  # neither the middle nor an end, where formulas often agree
                values.setdefault(template, {}).setdefault(field, round(value) if info.kind == "integer" else value)
    return frozenset(facts | {Fact.of(name, **fields) for name, fields in values.items()})
