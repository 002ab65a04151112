"""`tie`: two proposals that only the ids of their rules tell apart."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.checks.logic import of_rule
from expert.rules.checks.proposals import Proposal, proposals
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    groups: dict[tuple[str, float, int], list[Proposal]] = {}
    for proposal in proposals(context):
        groups.setdefault((proposal.target, proposal.score, proposal.rule.priority), []).append(proposal)
    for group in groups.values():
        for one, two in itertools.combinations(sorted(group, key=lambda item: item.rule.id), 2):
            if one.rule.id == two.rule.id or one.value == two.value or of_rule(one.scope).excludes(of_rule(two.scope)):
                continue
            message = (
                f"proposes {two.said} for {one.target} with the score and priority "
                f"with which {one.rule.id} proposes {one.said}, so that the id decides"
            )
            yield two.scope.problem(two.path, "tie", message, "change a score or a priority")


CHECK = Check(
    "tie",
    "warning",
    "Two rules that may fire together propose different things for one slot or parameter, equal in score and priority.",
    "The id decides, which is repeatable, but no reason.",
    "Give the better one a higher score or priority, or conditions that exclude each other.",
    _find,
)
