"""`unreachable-rule`: a rule that waits for what never comes."""

from __future__ import annotations

from collections.abc import Iterator

from expert.facts import SEVERITIES
from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, RuleScope, derived_by, each
from expert.rules.checks.logic import of_rule
from expert.rules.model import STAGES, AnyOf, Choose, Comparison, Condition, Exists, FindingCondition, Measure, Repair
from expert.rules.problem import Problem

_PRODUCTS = {"disparity": "matching", "terrain": "reconstruction"}


class _World:
    """What can be there at all, given which rules can fire."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.order = [str(stage) for stage in STAGES]
        self.reachable: set[str] = set()
        self.deriving: dict[str, list[tuple[RuleScope, str]]] = {}
        self.asking: dict[str, list[RuleScope]] = {}
        for scope in context.scopes:
            for name, severity in derived_by(scope.rule).items():
                self.deriving.setdefault(name, []).append((scope, severity))
            for action in scope.rule.then:
                if isinstance(action, Measure):
                    self.asking.setdefault(action.measure, []).append(scope)

    def comes_before(self, other: RuleScope, scope: RuleScope) -> bool:
        """Say whether a rule may fire, in the stage of another or earlier."""
        earlier = self.order.index(other.rule.stage) <= self.order.index(scope.rule.stage)
        return earlier and other.rule.id in self.reachable and other.rule.id != scope.rule.id

    def lacks_finding(self, scope: RuleScope, condition: FindingCondition) -> str:
        """Say why a finding is never there; empty when it may be, or when no rule at all derives it."""
        if condition.finding not in self.deriving:
            return ""  # reported where it is declared
        severities = [
            SEVERITIES.index(severity)
            for other, severity in self.deriving[condition.finding]
            if self.comes_before(other, scope)
        ]
        if not severities:
            return f"no rule of this stage or an earlier one derives '{condition.finding}' for it"
        if max(severities) < SEVERITIES.index(condition.at_least):
            return f"'{condition.finding}' is {SEVERITIES[max(severities)]} at worst, never {condition.at_least}"
        return ""

    def lacks_fact(self, scope: RuleScope, condition: Comparison) -> str:
        """Say why a fact is never there; empty when it may be."""
        template = self.context.vocabulary.get(condition.fact)
        probe = self.context.probes.get(template.probe or "") if template else None
        if condition.fact == "planned":
            return self._lacks_planned(scope, condition)
        if probe is None:
            return ""
        stage = _PRODUCTS.get(probe.subject)
        if stage is not None and self.order.index(scope.rule.stage) < self.order.index(stage):
            return f"'{condition.fact}' is measured of the product of {stage}, after this stage"
        if probe.tier == "cheap" or any(self.comes_before(other, scope) for other in self.asking.get(probe.name, [])):
            return ""
        return f"'{condition.fact}' is measured by {probe.name}, which no rule of this stage or an earlier one asks for"

    def _lacks_planned(self, scope: RuleScope, condition: Comparison) -> str:
        if condition.op != "eq" or not isinstance(condition.value, str):
            return ""
        earlier = self.order[: self.order.index(scope.rule.stage)]
        if condition.field == "slot":
            stage, _, slot = condition.value.partition(".")
            if stage in earlier and slot in self.context.slots_of(stage):
                return ""
            return f"no earlier stage has a slot '{condition.value}'"
        if condition.field == "operator" and condition.value != "none":
            used = {slot.default for slot, _ in self.context.merged.slots.values()}
            for other in self.context.scopes:
                if other.rule.id in self.reachable:
                    used |= {item.choose for item in other.rule.then if isinstance(item, Choose)}
                    used |= {item.repair for item in other.rule.then if isinstance(item, Repair)}
            return "" if condition.value in used else f"nothing ever chooses '{condition.value}'"
        return ""

    def lacks(self, scope: RuleScope, condition: Condition) -> str:
        """Say why a condition can never hold; empty when it may."""
        if isinstance(condition, FindingCondition):
            return self.lacks_finding(scope, condition)
        if isinstance(condition, Comparison):
            return self.lacks_fact(scope, condition)
        if isinstance(condition, Exists):
            return next(filter(None, (self.lacks(scope, item) for item, _ in each(condition.exists, ()))), "")
        if isinstance(condition, AnyOf):
            branches = [
                next(filter(None, (self.lacks(scope, item) for item, _ in each(branch, ()))), "")
                for branch in condition.any_of
            ]
            return branches[0] if all(branches) else ""
        return ""


def _find(context: Context) -> Iterator[Problem]:
    world = _World(context)
    world.reachable = {scope.rule.id for scope in context.scopes if of_rule(scope).clash}  # reported elsewhere
    waiting = [scope for scope in context.scopes if scope.rule.id not in world.reachable]
    grown = True
    while grown:
        free = [scope for scope in waiting if not any(world.lacks(scope, item) for item in scope.rule.when)]
        world.reachable |= {scope.rule.id for scope in free}
        waiting = [scope for scope in waiting if scope.rule.id not in world.reachable]
        grown = bool(free)
    for scope in waiting:
        index, lacking = next(
            (index, said) for index, item in enumerate(scope.rule.when) if (said := world.lacks(scope, item))
        )
        message = f"the rule can never fire: {lacking}"
        hint = "derive, measure or choose it earlier, or remove the rule"
        yield scope.problem(("when", index), "unreachable-rule", message, hint)


CHECK = Check(
    "unreachable-rule",
    "warning",
    "A rule waits for a finding, a measurement or an operator that never comes before it.",
    "It looks like knowledge, is read and maintained, and never does anything.",
    "Let a rule of the same or an earlier stage derive the finding or ask for the measurement, or remove the rule.",
    _find,
)
