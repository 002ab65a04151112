"""The compiled engine: every rule becomes closures, layers of rules are run to their fixpoint one after another.

It follows the semantics in `expert.rules.model` literally, without any lowering, and so serves as the reference that
the other engine is compared with.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from threading import Lock

from expert.engine.cache import ProgramCache
from expert.engine.common import Record, canonical_facts
from expert.facts import Fact, Vocabulary
from expert.firing import MAX_FIRINGS, Firing, Firings
from expert.rules.evaluate import Bindings, Evaluator, finding_of, matches_finding, operand_aliases
from expert.rules.model import (
    AnyOf,
    Comparison,
    Condition,
    Exists,
    FindingCondition,
    ForAll,
    Not,
    Rule,
    RuleBase,
    Stage,
)
from expert.rules.strata import EVERY_FINDING, conditions_of, stratify, uses

Store = dict[str, list[Fact]]
Check = Callable[[Bindings], bool]
Test = Callable[[dict[str, Fact], Store], bool]


class Conjunction:
    """Conditions that have to hold together.

    Parameters
    ----------
    conditions : sequence of Condition
        The conditions.
    outer : frozenset of str
        Aliases that are bound around them.
    evaluator : Evaluator
        Evaluates the comparisons.
    """

    def __init__(self, conditions: Sequence[Condition], outer: frozenset[str], evaluator: Evaluator) -> None:
        comparisons = [condition for condition in conditions if isinstance(condition, Comparison)]
        templates: dict[str, str] = {}
        for comparison in comparisons:
            if comparison.name not in outer:
                templates.setdefault(comparison.name, comparison.fact)
        self._aliases = tuple(templates.items())
        scope = outer | templates.keys()
        bound = outer
        pending = [(comparison, _needs(comparison) & scope) for comparison in comparisons]
        self._checks: list[tuple[Check, ...]] = []
        for alias in (None, *templates):
            bound = bound if alias is None else bound | {alias}
            ready = [comparison for comparison, needs in pending if needs <= bound]
            pending = [(comparison, needs) for comparison, needs in pending if not needs <= bound]
            self._checks.append(tuple(evaluator.test(comparison) for comparison in ready))
        self._tests = tuple(
            _test(condition, scope, evaluator) for condition in conditions if not isinstance(condition, Comparison)
        )

    def solutions(self, bindings: dict[str, Fact], store: Store, level: int = 0) -> Iterator[dict[str, Fact]]:
        """Yield every extension of the bindings that satisfies the conditions."""
        for check in self._checks[level]:
            if not check(bindings):
                return
        if level == len(self._aliases):
            for test in self._tests:
                if not test(bindings, store):
                    return
            yield bindings
            return
        alias, template = self._aliases[level]
        for fact in store.get(template, ()):
            yield from self.solutions({**bindings, alias: fact}, store, level + 1)

    def holds(self, bindings: dict[str, Fact], store: Store) -> bool:
        """Say whether some extension of the bindings satisfies the conditions."""
        return next(self.solutions(bindings, store), None) is not None


def _needs(comparison: Comparison) -> frozenset[str]:
    return operand_aliases(comparison.value) | {comparison.name}


def _test(condition: Condition, scope: frozenset[str], evaluator: Evaluator) -> Test:
    if isinstance(condition, FindingCondition):
        wanted = condition
        return lambda _, store: any(matches_finding(wanted, fact) for fact in store.get("finding", ()))
    if isinstance(condition, Not):
        inside = Conjunction(conditions_of(condition.not_), scope, evaluator)
        return lambda bindings, store: not inside.holds(bindings, store)
    if isinstance(condition, Exists):
        return Conjunction(conditions_of(condition.exists), scope, evaluator).holds
    if isinstance(condition, AnyOf):
        branches = [Conjunction(conditions_of(branch), scope, evaluator) for branch in condition.any_of]
        return lambda bindings, store: any(branch.holds(bindings, store) for branch in branches)
    if isinstance(condition, ForAll):
        where = Conjunction(condition.for_all.where, scope, evaluator)
        named = frozenset(item.name for item in condition.for_all.where if isinstance(item, Comparison))
        then = Conjunction(condition.for_all.then, scope | named, evaluator)
        return lambda bindings, store: all(then.holds(found, store) for found in where.solutions(bindings, store))
    raise TypeError(f"{type(condition).__name__} is no test on bindings")


@dataclass(frozen=True)
class CompiledRule:
    """A rule, its closures, and the findings that make it worth trying again."""

    rule: Rule
    when: Conjunction
    uses: frozenset[str]
    findings: tuple[Fact, ...]


@dataclass(frozen=True)
class Program:
    """The compiled rules of one stage, in layers."""

    layers: tuple[tuple[CompiledRule, ...], ...]
    evaluator: Evaluator


def compile_stage(rules: RuleBase, stage: Stage, vocabulary: Vocabulary) -> Program:
    """Compile the rules of one stage."""
    evaluator = Evaluator(vocabulary, rules.thresholds)

    def compile_rule(rule: Rule) -> CompiledRule:
        return CompiledRule(
            rule,
            Conjunction(rule.when, frozenset(), evaluator),
            frozenset(use.name for use in uses(rule.when)),
            tuple(fact for fact in map(finding_of, rule.then) if fact is not None),
        )

    layers = stratify(rules.of_stage(stage))
    return Program(tuple(tuple(compile_rule(rule) for rule in layer) for layer in layers), evaluator)


class CompiledEngine:
    """Stratified closures over facts, without any dependency; safe to use from several threads.

    Parameters
    ----------
    vocabulary : mapping of str to TemplateInfo
        Templates that rules may speak of.
    max_firings : int
        Cap on the firings of one inference.
    """

    name = "compiled"

    def __init__(self, vocabulary: Vocabulary, max_firings: int = MAX_FIRINGS) -> None:
        self._vocabulary = vocabulary
        self._max_firings = max_firings
        self._programs: ProgramCache[Program] = ProgramCache()
        self._lock = Lock()

    def infer(self, rules: RuleBase, stage: Stage, facts: Iterable[Fact]) -> Firings:
        """Fire every rule of one stage that the facts satisfy, until nothing new follows.

        Raises
        ------
        CyclicNegation
            Rules wait for each other's findings through `not` or `for_all`.
        RunawayRuleBase
            There are more firings than the cap allows.
        """
        with self._lock:
            program = self._programs.get(rules, stage, lambda: compile_stage(rules, stage, self._vocabulary))
        store: Store = {}
        known = dict.fromkeys(canonical_facts(facts))
        for fact in known:
            store.setdefault(fact.template, []).append(fact)
        record = Record(self._max_firings)
        for layer in program.layers:
            _run(layer, program.evaluator, known, store, record)
        return record.finish(known)


def _run(
    layer: tuple[CompiledRule, ...], evaluator: Evaluator, known: dict[Fact, None], store: Store, record: Record
) -> None:
    """Run one layer to its fixpoint."""
    waiting = deque(layer)
    queued = {item.rule.id for item in layer}
    while waiting:
        item = waiting.popleft()
        queued.discard(item.rule.id)
        fired = False
        for bindings in item.when.solutions({}, store):
            fired = True
            key = tuple(sorted(bindings.items(), key=lambda pair: pair[0]))
            if not record.knows(item.rule.id, key):
                record.add(Firing(item.rule.id, key, evaluator.actions(item.rule.then, bindings)))
        new = [fact for fact in item.findings if fact not in known] if fired else []
        if not new:
            continue
        for fact in new:
            if fact not in known:
                known[fact] = None
                store.setdefault("finding", []).append(fact)
        names = {EVERY_FINDING, *(str(fact.get("name")) for fact in new)}
        for other in layer:
            if other.uses & names and other.rule.id not in queued:
                queued.add(other.rule.id)
                waiting.append(other)
