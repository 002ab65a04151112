"""The RETE engine: lowered rules on experta, the only importer of that library.

Of the library only what is reliable is used: positive patterns, equality of variables, tests after the patterns and
negation of single patterns. The agenda is ordered totally and activations are withdrawn exactly, so that the same facts
fire the same productions in the same order every time. Nothing is ever retracted.

The library spends most of its time on what these networks do not need: it shows every fact to every pattern, checks
declared facts for patterns inside, and searches all rules for activations after every change. The subclasses here
leave that out and change nothing of how tokens are joined and negated.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable, Iterable, Mapping, Sequence
from inspect import Parameter, Signature
from threading import Lock
from typing import Any

from expert.engine.alpha import Alpha
from expert.engine.cache import ProgramCache
from expert.engine.common import Record, canonical_facts, conclusions
from expert.engine.lowering import Join, Pattern, Production, lower
from expert.engine.shim import importable
from expert.facts import Fact, Vocabulary
from expert.firing import MAX_FIRINGS, Firing, Firings
from expert.rules.evaluate import Evaluator, finding_of
from expert.rules.model import Rule, RuleBase, Stage

with importable():
    import experta
    from experta.abstract import Strategy
    from experta.agenda import Agenda
    from experta.factlist import FactList
    from experta.matchers import ReteMatcher
    from experta.matchers.rete.abstract import OneInputNode, TwoInputNode
    from experta.matchers.rete.mixins import AnyChild, ChildNode, NoMemory
    from experta.matchers.rete.nodes import ConflictSetNode
    from experta.matchers.rete.token import Token

Kind = str | int  # of an item: the template of a fact, or the number of a helper
INITIAL: Kind = "initial-fact"  # no template: these have no hyphen


class Row:
    """A fact in the network. Rows are compared by identity, which is what variables join on."""

    __slots__ = ("fact", "serial")

    def __init__(self, fact: Fact, serial: int) -> None:
        self.fact = fact
        self.serial = serial


class Item(experta.Fact):
    """A fact or a helper in the working memory: its kind, and the rows it speaks of. Compared by identity."""

    def __init__(self, kind: Kind, rows: tuple[Row, ...]) -> None:
        dict.__init__(self)
        self.kind, self.rows = kind, rows

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other


class Wanted(experta.Fact):
    """A pattern: the kind of item, what its fact has to fulfil, and the variables that take its rows."""

    def __init__(self, kind: Kind, variables: tuple[str, ...], alpha: Alpha | None = None) -> None:
        dict.__init__(self)
        self.kind, self.variables, self.alpha = kind, variables, alpha

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other


class Lhs(experta.Rule):
    """A production of the library, compared by identity; by value, every activation would compare all patterns."""

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other


class Entry(Token):
    """A token that enters the network; it is known to be sound and therefore copied without being checked again."""

    __slots__ = ()

    def __new__(cls, tag: Any, data: set[Any], context: dict[str, Row]) -> Entry:
        """Take the parts as they are."""
        return tuple.__new__(cls, (tag, data, context))

    def copy(self) -> Entry:
        """Return a token that its receiver may change."""
        return Entry(self.tag, self.data.copy(), self.context.copy())


class Admission(AnyChild, NoMemory, OneInputNode):
    """The node of a pattern: admits items, and gives their rows to the variables of the pattern."""

    def __init__(self, wanted: Wanted) -> None:
        self._alpha, self._variables = wanted.alpha, wanted.variables
        super().__init__()

    def offer(self, item: Item) -> None:
        """Pass an item on if the pattern admits it."""
        if self._alpha is None or self._alpha.admits(item.rows[0].fact):
            token = Entry(Token.TagType.VALID, {item}, dict(zip(self._variables, item.rows, strict=False)))
            for child in self.children:
                child.callback(token)

    def _activate(self, token: Any) -> None:
        raise NotImplementedError("items are offered, tokens are not passed to it")


class Memory(FactList):
    """The working memory; every item once."""

    def __init__(self) -> None:
        super().__init__()
        self._known: set[tuple[Any, ...]] = set()

    def declare(self, item: Item) -> Item | None:
        """Add an item unless there is one of its kind with the same rows."""
        identity = item.kind, item.rows
        if identity in self._known:
            return None
        self._known.add(identity)
        item.__factid__ = self.last_index
        self[self.last_index] = item
        self.last_index += 1
        self.added.append(item)
        return item


class TotalOrder(Strategy):
    """Agenda order by salience, production and rows; the last activation is the next to run."""

    def _update_agenda(self, agenda: Any, added: Sequence[Any], removed: Sequence[Any]) -> None:
        for activation in removed:
            activation.key = _agenda_key(activation)
            index = bisect.bisect_left(agenda.activations, activation)
            if index < len(agenda.activations) and agenda.activations[index].key == activation.key:
                del agenda.activations[index]
        for activation in added:
            activation.key = _agenda_key(activation)
            agenda.activations.append(activation)
        if added:
            agenda.activations.sort(key=_key_of)


def _key_of(activation: Any) -> tuple[Any, ...]:
    key: tuple[Any, ...] = activation.key
    return key


def _agenda_key(activation: Any) -> tuple[Any, ...]:
    """Return a key that tells all activations apart: the helpers of a production are determined by its rows."""
    rule, context = activation.rule, activation.context
    return rule.salience, -rule.order, *(-context[name].serial for name in rule.variables)


class QuietMatcher(ReteMatcher):
    """The RETE matcher with one node per distinct pattern, found by kind, that only visits rules that changed."""

    @staticmethod
    def prepare_ruleset(engine: Any) -> list[Any]:
        """Return the productions, which are in normal form already."""
        rules: list[Any] = engine.get_rules()
        return rules

    def build_alpha_part(self, ruleset: Iterable[Any], root_node: Any) -> dict[Any, Admission]:
        """Return the node of every pattern; equal patterns have one node."""
        self._by_kind: dict[Kind, list[Admission]] = {}
        nodes: dict[tuple[Any, ...], Admission] = {}
        terminals = {}
        for rule in ruleset:
            for wanted in rule.patterns:
                key = wanted.kind, wanted.variables, wanted.alpha
                if key not in nodes:
                    nodes[key] = Admission(wanted)
                    self._by_kind.setdefault(wanted.kind, []).append(nodes[key])
                    root_node.add_child(nodes[key], nodes[key].offer)
                terminals[wanted] = nodes[key]
        return terminals

    def build_beta_part(self, ruleset: Iterable[Any], alpha_terminals: Mapping[Any, Admission]) -> None:
        """Wire the joins; note which rules have changed, and which nodes have a memory."""
        super().build_beta_part(ruleset, alpha_terminals)
        self._changed: dict[Any, None] = {}
        found: dict[Any, None] = {}
        waiting = [self.root_node]
        while waiting:
            node = waiting.pop()
            if node in found:
                continue
            found[node] = None
            for index, child in enumerate(node.children):
                waiting.append(child.node)
                if isinstance(child.node, ConflictSetNode):
                    node.children[index] = ChildNode(child.node, self._noting(child.node))
                elif isinstance(child.node, TwoInputNode):  # it only reads its tokens, and needs no copy
                    direct = getattr(child.node, f"_{child.callback.__name__}")
                    node.children[index] = ChildNode(child.node, direct)
        self._joins = [node for node in found if isinstance(node, TwoInputNode)]
        self._ends = [node for node in found if isinstance(node, ConflictSetNode)]

    def _noting(self, node: Any) -> Callable[[Any], None]:
        def activate(token: Any) -> None:
            self._changed[node] = None
            node._activate(token)

        return activate

    def reset(self) -> None:
        """Empty every memory, each once."""
        self._changed.clear()
        for node in self._joins:
            node._reset()
        for node in self._ends:
            if node.memory or node.added or node.removed:
                node._reset()
                node.get_activations()

    def changes(self, adding: Any = None, deleting: Any = None) -> tuple[list[Any], list[Any]]:
        """Pass new items through the network and return the activations added and removed."""
        for item in adding or ():
            for node in self._by_kind.get(item.kind, ()):
                node.offer(item)
        added: list[Any] = []
        removed: list[Any] = []
        for node in self._changed:
            for total, part in zip((added, removed), node.get_activations(), strict=True):
                total.extend(part)
        self._changed.clear()
        return added, removed


class Network(experta.KnowledgeEngine):
    """The network of one stage, built once and reset for every inference.

    Parameters
    ----------
    productions : sequence of Production
        Lowered rules.
    evaluator : Evaluator
        Evaluates the actions.
    """

    __matcher__ = QuietMatcher
    __strategy__ = TotalOrder

    def __init__(self, productions: Sequence[Production], evaluator: Evaluator) -> None:
        self._evaluator = evaluator
        self._at_once: dict[str, list[tuple[Alpha, int]]] = {}
        for production in productions:
            if production.immediate:
                alpha = production.patterns[0].alpha
                self._at_once.setdefault(alpha.template, []).append((alpha, production.helper))
        self._templates = set(self._at_once)
        self._built = [self._build(*item) for item in enumerate(productions) if not item[1].immediate]
        self._record = Record(0)
        self._rows: dict[Fact, Row] = {}
        super().__init__()

    def get_rules(self) -> list[Any]:
        """Return the productions."""
        return self._built

    def reset(self, **_: Any) -> None:
        """Begin with an empty working memory."""
        self.agenda, self.facts, self.running = Agenda(), Memory(), False
        self.matcher.reset()
        self.declare(Item(INITIAL, ()))

    def declare(self, *items: Item) -> None:
        """Add items to the working memory; those that rules add wait for the end of the firing."""
        for item in items:
            self.facts.declare(item)
        if not self.running:
            self.strategy.update_agenda(self.agenda, *self.get_activations())

    def run(self) -> None:
        """Fire what is on the agenda until nothing is left; the texts of the library's log are not made."""
        self.running = True
        while True:
            self.strategy.update_agenda(self.agenda, *self.get_activations())
            activation = self.agenda.get_next()
            if activation is None:
                break
            activation.rule(self, **activation.context)
        self.running = False

    def infer(self, facts: Iterable[Fact], record: Record) -> Firings:
        """Run to the end on these facts alone."""
        self._record, self._rows = record, {}
        self.reset()
        self._assert(canonical_facts(facts))
        self.run()
        known, self._rows, self._record = self._rows, {}, Record(0)
        return record.finish(known)

    def _assert(self, facts: Iterable[Fact]) -> None:
        """Declare the facts that are new and that some pattern may admit, and the helpers that follow at once."""
        batch = []
        for fact in facts:
            if fact in self._rows:
                continue
            row = self._rows[fact] = Row(fact, len(self._rows))
            if fact.template in self._templates:
                batch.append(Item(fact.template, (row,)))
            batch += [Item(helper, ()) for alpha, helper in self._at_once.get(fact.template, ()) if alpha.admits(fact)]
        if batch:
            self.declare(*batch)

    def _build(self, order: int, production: Production) -> Any:
        names = {pattern.alias: f"v{index}" for index, pattern in enumerate(production.patterns)}
        there = [self._pattern(pattern, (names[pattern.alias],)) for pattern in production.patterns]
        helpers = [(use.negated, Wanted(use.helper, tuple(names[key] for key in use.keys))) for use in production.uses]
        there += [pattern for negated, pattern in helpers if not negated]
        there = there or [Wanted(INITIAL, ())]
        tests = [experta.TEST(_test(join, names)) for join in production.joins]
        absent = [pattern for negated, pattern in helpers if negated]
        absent += [self._pattern(pattern, ()) for pattern in production.absent]
        right = self._fire(production.rule, names) if production.rule else _note(production, names)
        built = Lhs(*there, *tests, *map(experta.NOT, absent), salience=production.rank)(right)
        built.order, built.variables, built.patterns = order, tuple(names.values()), [*there, *absent]
        return built

    def _pattern(self, pattern: Pattern, variables: tuple[str, ...]) -> Wanted:
        self._templates.add(pattern.alpha.template)
        return Wanted(pattern.alpha.template, variables, pattern.alpha)

    def _fire(self, rule: Rule, names: Mapping[str, str]) -> Callable[..., None]:
        aliases = sorted(names.items())
        findings = [fact for fact in map(finding_of, rule.then) if fact is not None]
        conclude = conclusions(rule, self._evaluator)

        def fire(network: Network, **rows: Row) -> None:
            bindings = tuple((alias, rows[name].fact) for alias, name in aliases)
            if not network._record.knows(rule.id, bindings):
                network._record.add(Firing(rule.id, bindings, conclude(dict(bindings))))
                network._assert(findings)

        return fire


def _note(production: Production, names: Mapping[str, str]) -> Callable[..., None]:
    variables = [names[key] for key in production.keys]

    def note(network: Network, **rows: Row) -> None:
        network.declare(Item(production.helper, tuple(rows[name] for name in variables)))

    return note


def _test(join: Join, names: Mapping[str, str]) -> Callable[..., bool]:
    """Return a join as a function whose signature names the variables it needs."""
    aliases = {names[alias]: alias for alias in join.aliases}

    def test(**rows: Row) -> bool:
        return join.check({aliases[name]: row.fact for name, row in rows.items()})

    parameters = [Parameter(name, Parameter.KEYWORD_ONLY) for name in aliases]
    test.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return test


class ExpertaEngine:
    """RETE inference by experta; one network per rule base and stage, used by one thread at a time.

    Parameters
    ----------
    vocabulary : mapping of str to TemplateInfo
        Templates that rules may speak of.
    max_firings : int
        Cap on the firings of one inference.

    Notes
    -----
    The cost grows with the number of firings times the number of rules; use the compiled engine for more than some
    hundred rules per stage.
    """

    name = "experta"

    def __init__(self, vocabulary: Vocabulary, max_firings: int = MAX_FIRINGS) -> None:
        self._vocabulary = vocabulary
        self._max_firings = max_firings
        self._networks: ProgramCache[Network] = ProgramCache()
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
            network = self._networks.get(rules, stage, lambda: self._build(rules, stage))
            try:
                return network.infer(facts, Record(self._max_firings))
            except BaseException:
                self._networks.drop(rules, stage)  # its working memory may still hold facts of this call
                raise

    def _build(self, rules: RuleBase, stage: Stage) -> Network:
        evaluator = Evaluator(self._vocabulary, rules.thresholds)
        return Network(lower(rules.of_stage(stage), evaluator), evaluator)
