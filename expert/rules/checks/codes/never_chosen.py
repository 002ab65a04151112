"""`never-chosen`: a proposal that another rule always beats."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.checks.logic import of_rule
from expert.rules.checks.proposals import Proposal, proposals
from expert.rules.model import Exclude
from expert.rules.problem import Problem


def _beaten(mine: Proposal, other: Proposal) -> bool:
    return (-other.score, -other.rule.priority, other.rule.id) < (-mine.score, -mine.rule.priority, mine.rule.id)


def _find(context: Context) -> Iterator[Problem]:
    found = list(proposals(context))
    by_target: dict[str, list[Proposal]] = {}
    for proposal in found:
        by_target.setdefault(proposal.target, []).append(proposal)
    excluding: dict[str, list[int]] = {}
    for index, scope in enumerate(context.scopes):
        for action in scope.rule.then:
            if isinstance(action, Exclude):
                excluding.setdefault(action.exclude, []).append(index)
    for mine in found:
        here = of_rule(mine.scope)
        for index in excluding.get(mine.operator, []):
            other = context.scopes[index]
            if other.rule.stage == mine.rule.stage and here.implies(of_rule(other)):
                message = f"'{mine.operator}' can never win: {other.rule.id} excludes it whenever this rule fires"
                yield mine.scope.problem(mine.path, "never-chosen", message, "remove the choice or the exclusion")
        for rival in by_target[mine.target]:
            if rival.rule.id == mine.rule.id or rival.value == mine.value or not _beaten(mine, rival):
                continue
            if here.implies(of_rule(rival.scope)):
                strength = f"score {rival.score:g}, priority {rival.rule.priority}"
                message = (
                    f"{mine.said} can never win: whenever this rule fires, {rival.rule.id} proposes {rival.said} "
                    f"for {mine.target} with {strength}"
                )
                hint = "give it a higher score, or remove it"
                yield mine.scope.problem(mine.path, "never-chosen", message, hint)
                break


CHECK = Check(
    "never-chosen",
    "warning",
    "A choice, or a value of a parameter, is beaten by another rule whenever its rule fires.",
    "It never has an effect. A choice that only answers when the stronger operator fails is meant sometimes; say so.",
    "Give it a higher score, remove it, or silence the warning with the reason that it is a fallback.",
    _find,
)
