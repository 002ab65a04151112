"""The catalog of checks: explicit, one entry per code."""

from __future__ import annotations

from collections.abc import Mapping

from expert.rules.checks.check import Check
from expert.rules.checks.codes import (
    alias,
    alias_conflict,
    ambiguous_value,
    bad_calculation,
    cycle,
    duplicate_id,
    duplicate_key,
    duplicate_name,
    empty_range,
    ignore_without_reason,
    impossible_condition,
    key_not_text,
    may_exceed,
    missing_case,
    missing_key,
    missing_operator,
    missing_rationale,
    missing_reference,
    never_chosen,
    not_finite,
    not_utf8,
    not_whole,
    out_of_range,
    override,
    reused_id,
    several_documents,
    slot_without_default,
    subsumed_rule,
    tag,
    tie,
    too_deep,
    too_large,
    too_long,
    too_short,
    unasked_finding,
    undeclared_finding,
    undefined_threshold,
    underived_finding,
    unknown_action,
    unknown_alias,
    unknown_fact,
    unknown_field,
    unknown_key,
    unknown_operator,
    unknown_parameter,
    unknown_probe,
    unknown_rule,
    unknown_slot,
    unknown_stage,
    unknown_value,
    unreachable_rule,
    unreadable,
    unused_finding,
    unused_ignore,
    unused_threshold,
    wrong_pattern,
    wrong_slot,
    wrong_stage,
    wrong_type,
    wrong_unit,
    wrong_version,
    yaml_syntax,
)
from expert.rules.checks.context import Context
from expert.rules.problem import Problem

CHECKS: Mapping[str, Check] = {
    module.CHECK.code: module.CHECK
    for module in (
        alias,
        alias_conflict,
        ambiguous_value,
        bad_calculation,
        cycle,
        duplicate_id,
        duplicate_key,
        duplicate_name,
        empty_range,
        ignore_without_reason,
        impossible_condition,
        key_not_text,
        may_exceed,
        missing_case,
        missing_key,
        missing_operator,
        missing_rationale,
        missing_reference,
        never_chosen,
        not_finite,
        not_utf8,
        not_whole,
        out_of_range,
        override,
        reused_id,
        several_documents,
        slot_without_default,
        subsumed_rule,
        tag,
        tie,
        too_deep,
        too_large,
        too_long,
        too_short,
        unasked_finding,
        undeclared_finding,
        undefined_threshold,
        underived_finding,
        unknown_action,
        unknown_alias,
        unknown_fact,
        unknown_field,
        unknown_key,
        unknown_operator,
        unknown_parameter,
        unknown_probe,
        unknown_rule,
        unknown_slot,
        unknown_stage,
        unknown_value,
        unreachable_rule,
        unreadable,
        unused_finding,
        unused_ignore,
        unused_threshold,
        wrong_pattern,
        wrong_slot,
        wrong_stage,
        wrong_type,
        wrong_unit,
        wrong_version,
        yaml_syntax,
    )
}


def errors(context: Context) -> list[Problem]:
    """Return what keeps the rules from loading."""
    return _found(context, "error")


def warnings(context: Context) -> list[Problem]:
    """Return what their author should look at or know; asked only of rules without errors."""
    return _found(context, "warning") + _found(context, "note")


def _found(context: Context, level: str) -> list[Problem]:
    checks = (check for check in CHECKS.values() if check.level == level and check.find is not None)
    return [problem for check in checks if check.find for problem in check.find(context)]
