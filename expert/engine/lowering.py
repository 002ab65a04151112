"""Lowering of rules to productions that any RETE network executes alike.

A production has positive patterns, joins between them, positive or negated uses of helper facts, and single negated
patterns that share no variable with the others. Every group of the language (`not`, `any_of`, `exists`, `for_all`)
becomes productions of its own that assert a helper fact; the fact carries the outer facts that the group speaks of, so
that the group's owner only asks whether it is there. A helper is ranked before its owner, an inner one before an outer
one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from expert.engine.alpha import Alpha, Alphas
from expert.engine.common import mentioned
from expert.rules.evaluate import Bindings, Evaluator, matches_finding, operand_aliases
from expert.rules.model import AnyOf, Comparison, Condition, Exists, FindingCondition, ForAll, Not, Rule
from expert.rules.strata import conditions_of, stratify

Check = Callable[[Bindings], bool]


@dataclass(frozen=True)
class Pattern:
    """One fact, bound to an alias, that fulfils an alpha condition."""

    alias: str
    alpha: Alpha


@dataclass(frozen=True)
class Join:
    """A check on several aliases."""

    aliases: tuple[str, ...]
    check: Check


@dataclass(frozen=True)
class HelperUse:
    """A helper fact that has to be there, or must not be there."""

    helper: int
    keys: tuple[str, ...]
    negated: bool = False


@dataclass
class Production:
    """Left side of one production and what it concludes: a rule's firing, or else a helper fact.

    Attributes
    ----------
    rank : int
        Productions of a higher rank fire first.
    """

    patterns: tuple[Pattern, ...]
    joins: tuple[Join, ...]
    uses: tuple[HelperUse, ...]
    absent: tuple[Pattern, ...]
    rule: Rule | None = None
    helper: int = -1
    keys: tuple[str, ...] = ()
    layer: int = 0
    depth: int = 0
    rank: int = 0

    @property
    def immediate(self) -> bool:
        """Whether a single fact is enough to assert the helper, whatever else there is."""
        alone = len(self.patterns) == 1 and not (self.joins or self.uses or self.absent or self.keys)
        return alone and self.rule is None


@dataclass
class _Body:
    patterns: dict[str, Pattern]
    joins: list[Join] = field(default_factory=list)
    uses: list[HelperUse] = field(default_factory=list)
    absent: list[Pattern] = field(default_factory=list)

    def production(self, outer: Mapping[str, Pattern], keys: Sequence[str] = ()) -> Production:
        """Return a production over the outer patterns of the keys and its own."""
        patterns = (*(outer[key] for key in keys), *self.patterns.values())
        uses = tuple(dict.fromkeys(self.uses))
        return Production(patterns, tuple(self.joins), uses, tuple(self.absent), keys=tuple(keys))


def lower(rules: Sequence[Rule], evaluator: Evaluator) -> tuple[Production, ...]:
    """Lower the rules of one stage.

    Parameters
    ----------
    rules : sequence of Rule
        The rules.
    evaluator : Evaluator
        Evaluates the comparisons.

    Returns
    -------
    tuple of Production
        In a stable order.

    Raises
    ------
    CyclicNegation
        Rules wait for each other's findings through `not` or `for_all`.
    """
    lowering = _Lowering(evaluator)
    layers = stratify(rules)
    for layer, members in enumerate(layers):
        for rule in members:
            lowering.add_rule(rule, layer)
    deepest = max((production.depth for production in lowering.productions), default=0)
    for production in lowering.productions:
        production.rank = (len(layers) - production.layer) * (deepest + 1) + production.depth
    return tuple(lowering.productions)


class _Lowering:
    def __init__(self, evaluator: Evaluator) -> None:
        self.productions: list[Production] = []
        self._evaluator = evaluator
        self._alphas = Alphas(evaluator)
        self._layer = 0
        self._helpers = 0
        self._noted: dict[FindingCondition, int] = {}

    def add_rule(self, rule: Rule, layer: int) -> None:
        """Add the productions of one rule."""
        self._layer = layer
        production = self._body(rule.when, {}, 0).production({})
        production.rule = rule
        production.layer = layer
        self.productions.append(production)

    def _body(self, conditions: Sequence[Condition], outer: Mapping[str, Pattern], depth: int) -> _Body:
        comparisons = [condition for condition in conditions if isinstance(condition, Comparison)]
        body = _Body(self._patterns(comparisons, outer))
        scope = {**outer, **body.patterns}
        for comparison in comparisons:
            needs = (operand_aliases(comparison.value) | {comparison.name}) & scope.keys()
            if needs != {comparison.name} or comparison.name in outer:
                body.joins.append(Join(tuple(sorted(needs)), partial(self._evaluator.comparison, comparison)))
        for condition in conditions:
            if not isinstance(condition, Comparison):
                self._group(condition, body, scope, depth)
        return body

    def _patterns(self, comparisons: Sequence[Comparison], outer: Mapping[str, Pattern]) -> dict[str, Pattern]:
        """Return one pattern per new alias, with the comparisons that concern it alone."""
        names = dict.fromkeys(item.name for item in comparisons if item.name not in outer)
        bound = outer.keys() | names.keys()
        patterns = {}
        for name in names:
            own = [item for item in comparisons if item.name == name]
            alone = [item for item in own if operand_aliases(item.value) & bound <= {name}]
            patterns[name] = Pattern(name, self._alphas.of(own[0].fact, alone))
        return patterns

    def _group(self, condition: Condition, body: _Body, scope: Mapping[str, Pattern], depth: int) -> None:
        """Add what a group asks of its owner's body, and the group's own productions."""
        if isinstance(condition, FindingCondition):
            body.uses.append(HelperUse(self._finding(condition), ()))
        elif isinstance(condition, Not):
            inside = conditions_of(condition.not_)
            alone = self._alone(inside, scope)
            if alone is not None:
                body.absent.append(alone)
            else:
                body.uses.append(self._helper([inside], scope, depth, negated=True))
        elif isinstance(condition, Exists):
            body.uses.append(self._helper([conditions_of(condition.exists)], scope, depth))
        elif isinstance(condition, AnyOf):
            body.uses.append(self._helper([conditions_of(branch) for branch in condition.any_of], scope, depth))
        elif isinstance(condition, ForAll):
            violated = Not.model_validate({"not": list(condition.for_all.then)})
            body.uses.append(self._helper([(*condition.for_all.where, violated)], scope, depth, negated=True))

    def _alone(self, conditions: Sequence[Condition], scope: Mapping[str, Pattern]) -> Pattern | None:
        """Return the pattern of a group that is one comparison without any outer alias."""
        if len(conditions) != 1 or not isinstance(conditions[0], Comparison) or mentioned(conditions) & scope.keys():
            return None
        comparison = conditions[0]
        return Pattern(comparison.name, self._alphas.of(comparison.fact, [comparison]))

    def _helper(
        self,
        branches: Sequence[Sequence[Condition]],
        scope: Mapping[str, Pattern],
        depth: int,
        negated: bool = False,
    ) -> HelperUse:
        """Add one production per branch, all asserting the same helper fact."""
        self._helpers += 1
        helper = self._helpers
        keys = tuple(sorted(frozenset().union(*map(mentioned, branches)) & scope.keys()))
        for branch in branches:
            production = self._body(branch, scope, depth + 1).production(scope, keys)
            production.helper, production.layer, production.depth = helper, self._layer, depth + 1
            self.productions.append(production)
        return HelperUse(helper, keys, negated)

    def _finding(self, condition: FindingCondition) -> int:
        """Return the helper that notes a finding of at least a severity."""
        if condition not in self._noted:
            self._helpers += 1
            self._noted[condition] = self._helpers

            alpha = Alpha(-1, "finding", (partial(matches_finding, condition),))
            pattern = Pattern("finding", alpha)
            self.productions.append(Production((pattern,), (), (), (), helper=self._helpers))
        return self._noted[condition]
