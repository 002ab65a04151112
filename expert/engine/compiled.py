"""The compiled engine: every rule becomes closures, layers of rules are run to their fixpoint one after another.

It follows the semantics in `expert.rules.model` literally, without any lowering, and so serves as the reference that
the other engine is compared with.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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

    def solutions(self, bindings: Mapping[str, Fact], store: Store) -> Iterator[dict[str, Fact]]:
        """Yield every extension of the bindings that satisfies the conditions."""
        found = dict(bindings)
        for check in self._checks[0]:
            if not check(found):
                return
        yield from self._extend(found, store, 0)

    def _extend(self, found: dict[str, Fact], store: Store, level: int) -> Iterator[dict[str, Fact]]:
        """Bind the aliases from one on; `found` is changed on the way and copied where it is yielded."""
        if level == len(self._aliases):
            for test in self._tests:
                if not test(found, store):
                    return
            yield found.copy()
            return
        alias, template = self._aliases[level]
        checks = self._checks[level + 1]
        for fact in store.get(template, ()):
            found[alias] = fact
            for check in checks:
                if not check(found):
                    break
            else:
                yield from self._extend(found, store, level + 1)

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
    """A rule, its closures, and the findings it asserts."""

    rule: Rule
    when: Conjunction
    findings: tuple[Fact, ...]


@dataclass(frozen=True)
class Layer:
    """Rules that are run to their fixpoint together, and which of them each finding makes worth trying again."""

    rules: tuple[CompiledRule, ...]
    users: Mapping[str, tuple[CompiledRule, ...]]


@dataclass(frozen=True)
class Program:
    """The compiled rules of one stage, in layers."""

    layers: tuple[Layer, ...]
    evaluator: Evaluator


def compile_stage(rules: RuleBase, stage: Stage, vocabulary: Vocabulary) -> Program:
    """Compile the rules of one stage."""
    evaluator = Evaluator(vocabulary, rules.thresholds)

    def compile_rule(rule: Rule) -> CompiledRule:
        return CompiledRule(
            rule,
            Conjunction(rule.when, frozenset(), evaluator),
            tuple(fact for fact in map(finding_of, rule.then) if fact is not None),
        )

    def compile_layer(members: Sequence[Rule]) -> Layer:
        compiled = tuple(compile_rule(rule) for rule in members)
        users: dict[str, list[CompiledRule]] = {}
        for item in compiled:
            for name in sorted({use.name for use in uses(item.rule.when)}):
                users.setdefault(name, []).append(item)
        return Layer(compiled, {name: tuple(items) for name, items in users.items()})

    return Program(tuple(map(compile_layer, stratify(rules.of_stage(stage)))), evaluator)


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


def _run(layer: Layer, evaluator: Evaluator, known: dict[Fact, None], store: Store, record: Record) -> None:
    """Run one layer to its fixpoint."""
    waiting = deque(layer.rules)
    queued = {item.rule.id for item in layer.rules}
    while waiting:
        item = waiting.popleft()
        queued.discard(item.rule.id)
        fired = False
        for bindings in item.when.solutions({}, store):
            fired = True
            key = tuple(sorted(bindings.items(), key=lambda pair: pair[0]))
            if not record.knows(item.rule.id, key):
                record.add(Firing(item.rule.id, key, evaluator.actions(item.rule.then, bindings)))
        for fact in item.findings if fired else ():
            if fact in known:
                continue
            known[fact] = None
            store.setdefault("finding", []).append(fact)
            for name in (EVERY_FINDING, str(fact.get("name"))):
                for other in layer.users.get(name, ()):
                    if other.rule.id not in queued:
                        queued.add(other.rule.id)
                        waiting.append(other)
