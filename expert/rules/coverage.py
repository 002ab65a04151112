"""Which rules, conditions and actions no case exercises."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from expert.facts import Vocabulary
from expert.firing import Engine
from expert.rules.cases import CaseFile, CaseResult, facts_of, meets
from expert.rules.checks.context import walk
from expert.rules.explain import action_text, condition_text
from expert.rules.load import LoadedRules
from expert.rules.margin import Judge, has_boundary
from expert.rules.model import Action, Condition, Rule


@dataclass(frozen=True)
class Coverage:
    """What lacks a kind of case.

    Attributes
    ----------
    rules, conditions, actions : int
        How many there are.
    without_firing, without_quiet, without_boundary : tuple of str
        Rule ids.
    never_true, never_false : tuple of str
        Conditions, those inside others included, that come out in one way only in all cases of their rule.
    never_expected : tuple of str
        Actions that no firing case expects.
    """

    rules: int
    conditions: int
    actions: int
    without_firing: tuple[str, ...]
    without_quiet: tuple[str, ...]
    without_boundary: tuple[str, ...]
    never_true: tuple[str, ...] = ()
    never_false: tuple[str, ...] = ()
    never_expected: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether nothing is missing."""
        lacking = (self.without_firing, self.without_quiet, self.without_boundary)
        return not any((*lacking, self.never_true, self.never_false, self.never_expected))

    def lines(self) -> Iterator[str]:
        """Write it, one line per kind and one per condition or action."""
        for label, lacking in (
            ("firing case", self.without_firing),
            ("quiet case", self.without_quiet),
            ("boundary case", self.without_boundary),
        ):
            yield f"without a {label}: {', '.join(lacking) or 'none'} ({len(lacking)} of {self.rules} rules)"
        for label, count, lacking in (
            ("conditions that no case makes true", self.conditions, self.never_true),
            ("conditions that no case makes false", self.conditions, self.never_false),
            ("actions that no case expects", self.actions, self.never_expected),
        ):
            yield f"{label}: {len(lacking) or 'none'} of {count}"
            yield from (f"  {item}" for item in lacking)


@dataclass
class _Seen:
    """What the cases of one rule do with its conditions and actions."""

    rule: Rule
    true: set[int] = field(default_factory=set)
    false: set[int] = field(default_factory=set)
    expected: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.conditions: list[Condition] = [condition for condition, _, _ in walk(self.rule)]


def coverage(
    loaded: LoadedRules,
    engine: Engine,
    results: Iterable[CaseResult],
    files: Iterable[CaseFile],
    vocabulary: Vocabulary,
    ids: Iterable[str] | None = None,
) -> Coverage:
    """Say what no passed case exercises.

    Parameters
    ----------
    loaded : LoadedRules
    engine : Engine
        Any engine; all agree.
    results : iterable of CaseResult
        Of the cases in `files`.
    files : iterable of CaseFile
    vocabulary : mapping
    ids : iterable of str, optional
        The rules to look at; all by default.
    """
    passed = [item for item in results if item.passed]
    wanted = None if ids is None else set(ids)
    rules = sorted(
        (rule for rule in loaded.base.rules if wanted is None or rule.id in wanted), key=lambda rule: rule.id
    )
    by_rule = {file.rule: file for file in files}
    seen = [_exercised(loaded, engine, vocabulary, rule, by_rule.get(rule.id)) for rule in rules]
    firing = {item.rule for item in passed if item.fired}
    quiet = {item.rule for item in passed if not item.fired}
    boundary = {item.rule for item in passed if item.boundary}
    thresholds = loaded.base.thresholds

    def said(item: _Seen, index: int) -> str:
        return f"{item.rule.id}: {condition_text(item.conditions[index], vocabulary, thresholds)}"

    def lacking(item: _Seen, known: set[int]) -> list[str]:
        return [said(item, index) for index in range(len(item.conditions)) if index not in known]

    return Coverage(
        len(rules),
        sum(len(item.conditions) for item in seen),
        sum(len(item.rule.then) for item in seen),
        tuple(rule.id for rule in rules if rule.id not in firing),
        tuple(rule.id for rule in rules if rule.id not in quiet),
        tuple(rule.id for rule in rules if rule.id not in boundary and has_boundary(rule, vocabulary)),
        tuple(text for item in seen for text in lacking(item, item.true)),
        tuple(text for item in seen for text in lacking(item, item.false)),
        tuple(
            f"{item.rule.id}: {action_text(action, thresholds)}"
            for item in seen
            for index, action in enumerate(item.rule.then)
            if index not in item.expected
        ),
    )


def _exercised(loaded: LoadedRules, engine: Engine, vocabulary: Vocabulary, rule: Rule, file: CaseFile | None) -> _Seen:
    seen = _Seen(rule)
    base = loaded.base.model_copy(update={"rules": [rule]})
    for case, _ in file.cases if file else ():
        facts = facts_of(case)
        for index, holds in Judge(base, vocabulary, facts).outcomes(rule):
            (seen.true if holds else seen.false).add(index)
        if case.fires and case.expect is not None:
            for firing in engine.infer(base, rule.stage, facts).firings:
                for resolved in firing.actions:
                    action: Action = rule.then[resolved.index]
                    if meets(case.expect, action, resolved):
                        seen.expected.add(resolved.index)
    return seen
