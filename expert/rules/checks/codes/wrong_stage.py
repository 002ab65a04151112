"""`wrong-stage`: a rule that speaks of an operator of another stage."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context, named_operators
from expert.rules.model import STAGES
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    order = [str(stage) for stage in STAGES]
    for scope in context.scopes:
        stage = scope.rule.stage
        for action, path in scope.actions:
            for name, where, earlier in named_operators(action, path):
                operator = context.operators.get(name)
                if name in context.probes and stage != "measurement":
                    message = f"probe '{name}' runs before this stage and cannot be left out in it"
                    yield scope.problem(where, "wrong-stage", message, "move the rule to stage measurement")
                if operator is None:
                    continue
                mine, its = order.index(stage), order.index(operator.stage) if operator.stage in order else -1
                if its != mine and not (earlier and its <= mine):
                    message = f"'{name}' belongs to stage {operator.stage}, the rule to {stage}"
                    yield scope.problem(where, "wrong-stage", message, f"move the rule to stage {operator.stage}")


CHECK = Check(
    "wrong-stage",
    "error",
    "A rule chooses, excludes or sets an operator of another stage than its own.",
    "Each stage is planned by its own rules; only `repair` and `adjust` may reach back to an earlier stage.",
    "Give the rule the stage of the operator.",
    _find,
)
