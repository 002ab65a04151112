"""Errors that keep a rule base from loading: names that mean nothing, values that cannot be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from expert.facts import Vocabulary
from expert.rules.checks.comparisons import check_comparison
from expert.rules.checks.context import Context, RuleScope, walk
from expert.rules.checks.parameters import check_adjust, check_parameter, check_slot_values
from expert.rules.layers import Merged
from expert.rules.model import (
    STAGES,
    Adjust,
    Assess,
    Choose,
    Comparison,
    Derive,
    Exclude,
    FindingCondition,
    Measure,
    Repair,
    Set,
)
from expert.rules.problem import Problem, suggest
from expert.rules.reader import Path
from expert.rules.strata import CyclicNegation, stratify
from modules.operator import Operator
from modules.probe import Probe


def _check_finding(scope: RuleScope, name: str, path: Path) -> None:
    known = scope.context.merged.named_findings
    if name not in known:
        hint = suggest(name, known) or "declare it under `findings`"
        scope.complain(path, "undeclared-finding", f"finding '{name}' is not declared", hint)


def _check_operator(scope: RuleScope, name: str, path: Path, *, earlier: bool = False) -> Operator | None:
    """Complain about an operator that does not exist or belongs to a stage this rule cannot speak of."""
    operator = scope.context.operators.get(name)
    if operator is None:
        known = scope.context.operators
        scope.complain(path, "unknown-operator", f"there is no operator '{name}'", suggest(name, known))
        return None
    stage = scope.rule.stage
    order = [str(item) for item in STAGES]
    mine, its = order.index(stage), order.index(operator.stage) if operator.stage in order else -1
    if its != mine and not (earlier and its <= mine):
        message = f"'{name}' belongs to stage {operator.stage}, the rule to {stage}"
        scope.complain(path, "wrong-stage", message, f"move the rule to stage {operator.stage}")
    return operator


def _check_proposal(scope: RuleScope, action: Choose | Repair, path: Path) -> None:
    """Check choose and repair: operator, slot, parameters."""
    kind = "choose" if isinstance(action, Choose) else "repair"
    name = action.choose if isinstance(action, Choose) else action.repair
    slots = {slot for stage, slot in scope.context.merged.named_slots if stage == scope.rule.stage}
    if name == "none":
        if action.slot is None:
            scope.complain(path, "missing-key", f"`{kind}: none` does not say for which slot", "add `slot:`")
        if action.with_:
            scope.complain((*path, "with"), "unknown-parameter", "`none` has no parameters", "remove `with`")
    operator = None if name == "none" else _check_operator(scope, name, (*path, kind), earlier=kind == "repair")
    if operator is not None:
        slots = {slot for stage, slot in scope.context.merged.named_slots if stage == operator.stage}
        if action.slot is None and operator.slot not in slots:
            message = f"'{name}' fills slot '{operator.slot}', which stage {operator.stage} does not declare"
            scope.complain((*path, kind), "unknown-slot", message, "declare the slot under `slots`")
        if action.slot is not None and action.slot in slots and action.slot != operator.slot:
            message = f"'{name}' fills slot '{operator.slot}', not '{action.slot}'"
            scope.complain((*path, "slot"), "wrong-slot", message, "remove `slot:`")
        for parameter, operand in action.with_.items():
            check_parameter(scope, operator, parameter, operand, (*path, "with", parameter))
    if action.slot is not None and action.slot not in slots:
        scope.complain(
            (*path, "slot"), "unknown-slot", f"there is no slot '{action.slot}'", suggest(action.slot, slots)
        )
    for parameter, operand in action.with_.items():
        scope.check_operand(operand, (*path, "with", parameter), inside=False)


def _check_action(scope: RuleScope, action: Any, path: Path) -> None:
    if isinstance(action, Derive):
        _check_finding(scope, action.derive, (*path, "derive"))
    elif isinstance(action, Assess):
        _check_finding(scope, action.assess, (*path, "assess"))
    elif isinstance(action, Measure):
        if action.measure not in scope.context.probes:
            hint = suggest(action.measure, scope.context.probes)
            scope.complain((*path, "measure"), "unknown-probe", f"there is no probe '{action.measure}'", hint)
    elif isinstance(action, Choose | Repair):
        _check_proposal(scope, action, path)
    elif isinstance(action, Exclude):
        _check_operator(scope, action.exclude, (*path, "exclude"))
    elif isinstance(action, Set):
        operator = _check_operator(scope, action.set, (*path, "set"))
        scope.check_operand(action.to, (*path, "to"), inside=False)
        if operator is not None:
            check_parameter(scope, operator, action.parameter, action.to, (*path, "to"), (*path, "parameter"))
    elif isinstance(action, Adjust):
        operator = _check_operator(scope, action.adjust, (*path, "adjust"), earlier=True)
        check_adjust(scope, operator, action, path)


def _check_rule(scope: RuleScope) -> None:
    for condition, path, depth in walk(scope.rule):
        if isinstance(condition, Comparison):
            check_comparison(scope, condition, path, inside=depth > 0)
        elif isinstance(condition, FindingCondition):
            _check_finding(scope, condition.finding, (*path, "finding"))
    for index, action in enumerate(scope.rule.then):
        _check_action(scope, action, ("then", index))


def _slot_problems(context: Context) -> list[Problem]:
    problems: list[Problem] = []
    for (stage, name), (slot, origin) in context.merged.slots.items():
        if slot.default == "none":
            if slot.with_:
                message = f"slot {name}: `none` has no parameters"
                problems.append(origin.problem(("with",), "unknown-parameter", message, "remove `with`"))
            continue
        operator = context.operators.get(slot.default)
        if operator is None:
            message = f"slot {name}: there is no operator '{slot.default}'"
            hint = suggest(slot.default, context.operators)
            problems.append(origin.problem(("default",), "unknown-operator", message, hint))
            continue
        if (operator.stage, operator.slot) != (stage, name):
            message = f"slot {stage}.{name}: '{slot.default}' fills {operator.stage}.{operator.slot}"
            problems.append(origin.problem(("default",), "wrong-slot", message, "choose an operator of this slot"))
        problems += check_slot_values(operator, slot, origin)
    return problems


def _cycle_problems(merged: Merged) -> list[Problem]:
    problems: list[Problem] = []
    for stage in STAGES:
        try:
            stratify(rule for rule, _ in merged.rules.values() if rule.stage == stage)
        except CyclicNegation as error:
            sentence, _, hint = str(error).partition("; ")
            problems.append(merged.rules[error.rules[0]][1].problem((), "cycle", sentence, hint))
    return problems


def reference_problems(
    merged: Merged, vocabulary: Vocabulary, operators: Mapping[str, Operator], probes: Mapping[str, Probe]
) -> list[Problem]:
    """Return every error in what the rules refer to."""
    context = Context(merged, vocabulary, operators, probes)
    problems = _slot_problems(context) + _cycle_problems(merged)
    for rule, origin in merged.rules.values():
        scope = RuleScope.of(context, rule, origin)
        _check_rule(scope)
        problems += scope.problems
    return problems
