"""The RETE engine: lowered rules on experta, the only importer of that library.

Of the library only what is reliable is used: positive patterns, equality of variables, tests after the patterns and
negation of single patterns. The agenda is ordered totally and activations are withdrawn exactly, so that the same facts
fire the same productions in the same order every time.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable, Iterable, Mapping, Sequence
from inspect import Parameter, Signature
from threading import Lock
from typing import Any

from expert.engine.cache import ProgramCache
from expert.engine.common import Record, canonical_facts
from expert.engine.lowering import Join, Pattern, Production, lower
from expert.engine.shim import importable
from expert.facts import Fact, Vocabulary
from expert.firing import MAX_FIRINGS, Firing, Firings
from expert.rules.evaluate import Evaluator, finding_of
from expert.rules.model import Rule, RuleBase, Stage

with importable():
    import experta
    from experta.abstract import Strategy
    from experta.matchers import ReteMatcher


class Row:
    """A fact in the network. Rows are compared by identity, which is what variables join on."""

    __slots__ = ("fact", "serial")

    def __init__(self, fact: Fact, serial: int) -> None:
        self.fact = fact
        self.serial = serial


class TotalOrder(Strategy):
    """Agenda order by salience, production, bindings and facts; the last activation is the next to run."""

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
            agenda.activations.sort(key=lambda activation: activation.key)


def _agenda_key(activation: Any) -> tuple[Any, ...]:
    rule = activation.rule
    rows = tuple((name, -value.serial) for name, value in sorted(activation.context.items()) if isinstance(value, Row))
    facts = tuple(sorted(-fact["__factid__"] for fact in activation.facts))
    return rule.salience, -rule.order, rows, facts


class QuietMatcher(ReteMatcher):
    """The RETE matcher, which does not search all rules for changes when no fact has changed."""

    def changes(self, adding: Any = None, deleting: Any = None) -> tuple[list[Any], list[Any]]:
        """Pass changes of facts through the network and return the activations added and removed."""
        if not adding and not deleting:
            return [], []
        changed: tuple[list[Any], list[Any]] = super().changes(adding, deleting)
        return changed


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
        self._helper_class: type[Any] = type("Helper", (experta.Fact,), {})
        self._classes: dict[str, type[Any]] = {}
        self._built = [self._build(order, production) for order, production in enumerate(productions)]
        self._deffacts = list(super().get_deffacts())
        self._record = Record(0)
        self._rows: dict[Fact, Row] = {}
        super().__init__()

    def get_rules(self) -> list[Any]:
        """Return the productions."""
        return self._built

    def get_deffacts(self) -> list[Any]:
        """Return the initial fact, without a search through all attributes at every reset."""
        return self._deffacts

    def infer(self, facts: Iterable[Fact], record: Record) -> Firings:
        """Run to the end on these facts alone."""
        self._record, self._rows = record, {}
        self.reset()
        self._assert(canonical_facts(facts))
        self.run()
        known, self._rows, self._record = self._rows, {}, Record(0)
        return record.finish(known)

    def _assert(self, facts: Iterable[Fact]) -> None:
        """Declare the facts that are new and that some pattern may match, in one batch."""
        batch = []
        for fact in facts:
            if fact not in self._rows:
                self._rows[fact] = Row(fact, len(self._rows))
                if fact.template in self._classes:
                    batch.append(self._classes[fact.template](row=self._rows[fact]))
        if batch:
            self.declare(*batch)

    def _build(self, order: int, production: Production) -> Any:
        names = {pattern.alias: f"v{index}" for index, pattern in enumerate(production.patterns)}
        left = [self._pattern(pattern, names[pattern.alias]) for pattern in production.patterns]
        helpers = [
            (use.negated, self._helper_class(id=use.helper, **_keys(use.keys, names, lambda name: name << experta.W())))
            for use in production.uses
        ]
        left += [pattern for negated, pattern in helpers if not negated]
        left += [experta.TEST(_test(join, names)) for join in production.joins]
        left += [experta.NOT(pattern) for negated, pattern in helpers if negated]
        left += [experta.NOT(self._pattern(pattern, None)) for pattern in production.absent]
        right = self._fire(production.rule, names) if production.rule else self._note(production, names)
        right.order = order  # type: ignore[attr-defined]
        return experta.Rule(*left, salience=production.rank)(right)

    def _pattern(self, pattern: Pattern, name: str | None) -> Any:
        alias, checks = pattern.alias, pattern.checks

        def matches(row: Row) -> bool:
            bindings = {alias: row.fact}
            return all(check(bindings) for check in checks)

        known = self._classes.setdefault(pattern.template, type("Item", (experta.Fact,), {}))
        return known(row=experta.P(matches, name))

    def _fire(self, rule: Rule, names: Mapping[str, str]) -> Callable[..., None]:
        aliases = sorted(names.items())
        findings = [fact for fact in map(finding_of, rule.then) if fact is not None]

        def fire(network: Network, **rows: Row) -> None:
            bindings = tuple((alias, rows[name].fact) for alias, name in aliases)
            if not network._record.knows(rule.id, bindings):
                actions = network._evaluator.actions(rule.then, dict(bindings))
                network._record.add(Firing(rule.id, bindings, actions))
                network._assert(findings)

        return fire

    def _note(self, production: Production, names: Mapping[str, str]) -> Callable[..., None]:
        helper, keys = production.helper, production.keys

        def note(network: Network, **rows: Row) -> None:
            network.declare(network._helper_class(id=helper, **_keys(keys, names, rows.__getitem__)))

        return note


def _keys(aliases: Sequence[str], names: Mapping[str, str], value: Callable[[str], Any]) -> dict[str, Any]:
    """Return the fields of a helper fact that hold the outer facts."""
    return {f"k{index}": value(names[alias]) for index, alias in enumerate(aliases)}


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
