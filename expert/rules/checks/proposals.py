"""What rules propose for the slots of a plan and for the parameters of operators."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from expert.rules.checks.context import Context, RuleScope
from expert.rules.explain import operand_text
from expert.rules.model import Choose, Rule, Set
from expert.rules.reader import Path


@dataclass(frozen=True)
class Proposal:
    """An operator for a slot, or a value for a parameter.

    Attributes
    ----------
    target : str
        The slot or parameter, in words.
    operator : str
        The proposed operator, or the one whose parameter is set.
    value : str
        What is proposed; two proposals of one value do not contradict each other.
    said : str
        The same in words.
    """

    target: str
    operator: str
    value: str
    said: str
    score: float
    scope: RuleScope
    path: Path

    @property
    def rule(self) -> Rule:
        """Who proposes it."""
        return self.scope.rule


def proposals(context: Context) -> Iterator[Proposal]:
    """Yield every proposal of every rule."""
    for scope in context.scopes:
        for action, path in scope.actions:
            if isinstance(action, Choose):
                operator = context.operators.get(action.choose)
                slot = action.slot or (operator.slot if operator else "")
                target = f"slot {scope.rule.stage}.{slot}"
                said = "nothing" if action.choose == "none" else action.choose
                yield Proposal(target, action.choose, action.choose, said, action.score, scope, (*path, "choose"))
            elif isinstance(action, Set):
                target = f"{action.set} {action.parameter}"
                said = operand_text(action.to)
                yield Proposal(target, action.set, repr(action.to), said, action.score, scope, (*path, "set"))
