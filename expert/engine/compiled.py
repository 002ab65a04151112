"""The compiled engine: every rule becomes closures, layers of rules are run to their fixpoint one after another.

What a single fact has to fulfil is evaluated once per fact and shared by all rules that ask it; a rule is passed over
as soon as no fact fulfils it for one of its aliases.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from threading import Lock

from expert.engine.alpha import Alpha, Alphas
from expert.engine.cache import ProgramCache
from expert.engine.common import Record, canonical_facts, conclusions, mentioned
from expert.engine.gates import Gates
from expert.facts import Fact, Vocabulary
from expert.firing import MAX_FIRINGS, Firing, Firings, ResolvedAction
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


class Memory:
    """The facts of one inference, and which of them each alpha condition admits, found out when first asked.

    Parameters
    ----------
    facts : iterable of Fact
        In canonical order.
    alphas : int
        Number of alpha conditions of the program.
    """

    def __init__(self, facts: Iterable[Fact], alphas: int) -> None:
        self.facts = dict.fromkeys(facts)
        self.by_template: dict[str, list[Fact]] = {}
        self._admitted: list[list[Fact] | None] = [None] * alphas
        for fact in self.facts:
            self.by_template.setdefault(fact.template, []).append(fact)

    def add(self, finding: Fact) -> bool:
        """Add a finding; say whether it is new."""
        if finding in self.facts:
            return False
        self.facts[finding] = None
        self.by_template.setdefault("finding", []).append(finding)
        return True

    def admitted(self, alpha: Alpha) -> Sequence[Fact]:
        """Return the facts that fulfil an alpha condition."""
        found = self._admitted[alpha.index]
        if found is None:
            found = [fact for fact in self.by_template.get(alpha.template, ()) if alpha.admits(fact)]
            if alpha.template != "finding":  # inference adds findings
                self._admitted[alpha.index] = found
        return found

    @property
    def findings(self) -> Sequence[Fact]:
        """The findings so far."""
        return self.by_template.get("finding", ())


Test = Callable[[dict[str, Fact], Memory], bool]


class Conjunction:
    """Conditions that have to hold together.

    Parameters
    ----------
    conditions : sequence of Condition
        The conditions.
    outer : frozenset of str
        Aliases that are bound around them.
    alphas : Alphas
        The alpha conditions of the program.
    evaluator : Evaluator
        Evaluates the joins.
    """

    def __init__(
        self, conditions: Sequence[Condition], outer: frozenset[str], alphas: Alphas, evaluator: Evaluator
    ) -> None:
        comparisons = [condition for condition in conditions if isinstance(condition, Comparison)]
        names = tuple(dict.fromkeys(item.name for item in comparisons if item.name not in outer))
        scope = outer | frozenset(names)
        alone = [item for item in comparisons if item.name not in outer and _needs(item) & scope == {item.name}]
        self.aliases = tuple((name, _alpha(name, comparisons, alone, alphas)) for name in names)
        joins = [item for item in comparisons if item not in alone]
        tests = [item for item in conditions if not isinstance(item, Comparison)]
        closed = [item for item in tests if not mentioned([item]) & scope]
        self.closed = tuple(_test(item, scope, alphas, evaluator) for item in closed)
        self._open = tuple(_test(item, scope, alphas, evaluator) for item in tests if item not in closed)
        self._joins = _by_level(joins, names, outer, evaluator)
        self._names = names
        self.free = not self._open and not any(self._joins)  # its aliases do not depend on each other

    def possible(self, memory: Memory) -> bool:
        """Say whether some fact may be bound to every alias, and the tests hold that speak of none."""
        for _, alpha in self.aliases:
            if not memory.admitted(alpha):
                return False
        for test in self.closed:  # noqa: SIM110 - a generator would double the time
            if not test({}, memory):
                return False
        return True

    def solutions(self, bindings: Mapping[str, Fact], memory: Memory) -> Iterator[dict[str, Fact]]:
        """Yield every extension of the bindings that satisfies the conditions."""
        if not self.possible(memory):
            return
        if self.free:
            for facts in product(*(memory.admitted(alpha) for _, alpha in self.aliases)):
                yield {**bindings, **dict(zip(self._names, facts, strict=True))}
            return
        found = dict(bindings)
        if all(check(found) for check in self._joins[0]):
            yield from self._extend(found, memory, 0)

    def _extend(self, found: dict[str, Fact], memory: Memory, level: int) -> Iterator[dict[str, Fact]]:
        """Bind the aliases from one on; `found` is changed on the way and copied where it is yielded."""
        if level == len(self.aliases):
            if all(test(found, memory) for test in self._open):
                yield found.copy()
            return
        alias, alpha = self.aliases[level]
        joins = self._joins[level + 1]
        for fact in memory.admitted(alpha):
            found[alias] = fact
            for join in joins:
                if not join(found):
                    break
            else:
                yield from self._extend(found, memory, level + 1)

    def holds(self, bindings: dict[str, Fact], memory: Memory) -> bool:
        """Say whether some extension of the bindings satisfies the conditions."""
        if self.free:
            return self.possible(memory)
        return next(self.solutions(bindings, memory), None) is not None


def _alpha(name: str, comparisons: Sequence[Comparison], alone: Sequence[Comparison], alphas: Alphas) -> Alpha:
    template = next(item.fact for item in comparisons if item.name == name)
    return alphas.of(template, [item for item in alone if item.name == name])


def _by_level(
    joins: Sequence[Comparison], names: Sequence[str], outer: frozenset[str], evaluator: Evaluator
) -> tuple[tuple[Callable[[Bindings], bool], ...], ...]:
    """Return the joins to check before any alias is bound, and after each of them."""
    scope, bound, pending, levels = outer | frozenset(names), outer, list(joins), []
    for name in (None, *names):
        bound = bound if name is None else bound | {name}
        ready = [item for item in pending if _needs(item) & scope <= bound]
        pending = [item for item in pending if item not in ready]
        levels.append(tuple(partial(evaluator.comparison, item) for item in ready))
    return tuple(levels)


def _needs(comparison: Comparison) -> frozenset[str]:
    return operand_aliases(comparison.value) | {comparison.name}


def _test(condition: Condition, scope: frozenset[str], alphas: Alphas, evaluator: Evaluator) -> Test:
    def conjunction(conditions: Sequence[Condition], bound: frozenset[str] = scope) -> Conjunction:
        return Conjunction(conditions, bound, alphas, evaluator)

    if isinstance(condition, FindingCondition):
        wanted = condition
        return lambda _, memory: any(matches_finding(wanted, fact) for fact in memory.findings)
    if isinstance(condition, Not):
        inside = conjunction(conditions_of(condition.not_))
        if inside.free:
            return lambda _, memory: not inside.possible(memory)
        return lambda bindings, memory: not inside.holds(bindings, memory)
    if isinstance(condition, Exists):
        return conjunction(conditions_of(condition.exists)).holds
    if isinstance(condition, AnyOf):
        branches = [conjunction(conditions_of(branch)) for branch in condition.any_of]
        return lambda bindings, memory: any(branch.holds(bindings, memory) for branch in branches)
    if isinstance(condition, ForAll):
        where = conjunction(condition.for_all.where)
        named = frozenset(item.name for item in condition.for_all.where if isinstance(item, Comparison))
        then = conjunction(condition.for_all.then, scope | named)
        return lambda bindings, memory: all(then.holds(each, memory) for each in where.solutions(bindings, memory))
    raise TypeError(f"{type(condition).__name__} is no test on bindings")


@dataclass(frozen=True, eq=False)
class CompiledRule:
    """A rule, its closures, and the findings it asserts."""

    id: str
    when: Conjunction
    conclude: Callable[[Bindings], tuple[ResolvedAction, ...]]
    findings: tuple[Fact, ...]


@dataclass(frozen=True)
class Layer:
    """Rules that are run to their fixpoint together, and which of them each finding makes worth trying again."""

    rules: tuple[CompiledRule, ...]
    gates: Gates
    users: Mapping[str, tuple[CompiledRule, ...]]


@dataclass(frozen=True)
class Program:
    """The compiled rules of one stage, in layers."""

    layers: tuple[Layer, ...]
    alphas: int


def compile_stage(rules: RuleBase, stage: Stage, vocabulary: Vocabulary) -> Program:
    """Compile the rules of one stage."""
    evaluator = Evaluator(vocabulary, rules.thresholds)
    alphas = Alphas(evaluator)

    def compile_rule(rule: Rule) -> CompiledRule:
        return CompiledRule(
            rule.id,
            Conjunction(rule.when, frozenset(), alphas, evaluator),
            conclusions(rule, evaluator),
            tuple(fact for fact in map(finding_of, rule.then) if fact is not None),
        )

    def compile_layer(members: Sequence[Rule]) -> Layer:
        compiled = tuple(compile_rule(rule) for rule in members)
        users: dict[str, list[CompiledRule]] = {}
        for rule, item in zip(members, compiled, strict=True):
            for name in sorted({use.name for use in uses(rule.when)}):
                users.setdefault(name, []).append(item)
        return Layer(compiled, Gates(members, evaluator), {name: tuple(items) for name, items in users.items()})

    layers = tuple(map(compile_layer, stratify(rules.of_stage(stage))))
    return Program(layers, len(alphas))


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
        memory = Memory(canonical_facts(facts), program.alphas)
        record = Record(self._max_firings)
        for layer in program.layers:
            _run(layer, memory, record)
        return record.finish(memory.facts)


def _candidates(layer: Layer, memory: Memory) -> Iterator[CompiledRule]:
    """Yield the rules whose comparisons with numbers some facts pass, as far as they can be told one by one."""
    passed = layer.gates.open(memory.by_template)
    for rule, asked, forbidden in zip(layer.rules, layer.gates.asked, layer.gates.forbidden, strict=True):
        for gate, rank in asked:
            if rank >= passed[gate]:
                break
        else:
            for gate, rank in forbidden:
                if rank < passed[gate]:
                    break
            else:
                yield rule


def _run(layer: Layer, memory: Memory, record: Record) -> None:
    """Run one layer to its fixpoint."""
    again = deque(_candidates(layer, memory))
    queued = set(again)
    while again:
        rule = again.popleft()
        queued.discard(rule)
        fired = False
        for bindings in rule.when.solutions({}, memory):
            fired = True
            key = tuple(sorted(bindings.items())) if len(bindings) > 1 else tuple(bindings.items())
            if not record.knows(rule.id, key):
                record.add(Firing(rule.id, key, rule.conclude(bindings)))
        for finding in rule.findings if fired else ():
            if memory.add(finding):
                for name in (EVERY_FINDING, str(finding.get("name"))):
                    for other in layer.users.get(name, ()):
                        if other not in queued:
                            queued.add(other)
                            again.append(other)
