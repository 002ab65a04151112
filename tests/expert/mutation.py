"""Mutation of the shipped rules: each small change of a rule has to make one of its cases fail.

Mutated are conditions (dropped, operator turned round or made strict, limit moved by 20 %) and actions (dropped, number
moved by 20 %, text or severity changed). Score, priority and the step of `adjust` are not: no case can expect them.

Run as a script for a table: `python tests/expert/mutation.py [RULE-ID ...]`.
"""

from __future__ import annotations

import copy
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError

from expert.engine import make_engine
from expert.facts import SEVERITIES, Vocabulary, vocabulary
from expert.firing import Engine
from expert.rules.cases import CaseFile, read_cases, run_case
from expert.rules.load import LoadedRules, load_rules
from expert.rules.model import Rule, Threshold
from modules.catalog import operators, probes

MOVE = 0.2
OTHER_OPS = {
    "eq": ("ne",),
    "ne": ("eq",),
    "in": ("not_in",),
    "not_in": ("in",),
    "lt": ("le", "ge"),
    "le": ("lt", "gt"),
    "gt": ("ge", "le"),
    "ge": ("gt", "lt"),
    "abs_lt": ("abs_le", "abs_ge", "lt"),
    "abs_le": ("abs_lt", "abs_gt", "le"),
    "abs_gt": ("abs_ge", "abs_le", "gt"),
    "abs_ge": ("abs_gt", "abs_lt", "ge"),
    "present": ("absent",),
    "absent": ("present",),
}
NOT_EXPECTABLE = ("score", "by", "times", "at_least", "at_most")
Path = tuple[str | int, ...]


@dataclass(frozen=True)
class Mutant:
    """A changed rule and what was changed."""

    rule: Rule
    change: str


def moved(number: float) -> tuple[float, float]:
    """Return a number made 20 % larger and smaller, an integer by 1 at least."""
    step = MOVE * abs(number) or 1.0
    if isinstance(number, int):
        whole = max(1, round(step))
        return number + whole, number - whole
    return number + step, number - step


def _values(value: Any, path: Path, thresholds: Mapping[str, Threshold]) -> Iterator[tuple[Path, Any, str]]:
    """Yield place, new value and description of every change of the numbers of an operand."""
    if isinstance(value, bool):
        yield path, not value, "negated"
    elif isinstance(value, int | float):
        for other in moved(value):
            yield path, other, f"{value} to {other:g}"
    elif isinstance(value, list):
        for index, item in enumerate(value):
            if isinstance(item, str):
                yield path, value[:index] + value[index + 1 :] or ["-"], f"{item} removed"
            else:
                yield from _values(item, (*path, index), thresholds)
    elif isinstance(value, dict) and "threshold" in value:
        limit = thresholds[value["threshold"]].value
        for other in moved(limit):
            yield path, other, f"{limit} to {other:g}"
    elif isinstance(value, dict):
        for key, item in value.items():
            if key not in ("field", "unit"):
                yield from _values(item, (*path, key), thresholds)
    elif isinstance(value, str):
        yield path, value + "x", f"{value} to another text"


def _condition_changes(
    condition: dict[str, Any], path: Path, thresholds: Mapping[str, Threshold]
) -> Iterator[tuple[Path, Any, str]]:
    for kind in ("not", "exists", "any_of"):
        inner = condition.get(kind)
        if isinstance(inner, list):
            for index, item in enumerate(inner):
                if len(inner) > 1:
                    yield (*path, kind), inner[:index] + inner[index + 1 :], f"branch {index + 1} dropped"
                if isinstance(item, dict):
                    yield from _condition_changes(item, (*path, kind, index), thresholds)
        elif isinstance(inner, dict):
            yield path, inner, f"{kind} dropped"
            yield from _condition_changes(inner, (*path, kind), thresholds)
    if "finding" in condition:
        yield (*path, "finding"), condition["finding"] + "-x", "another finding"
        yield path, {"not": condition}, "negated"
        for least in SEVERITIES:
            if least != condition.get("at_least", SEVERITIES[0]):
                yield (*path, "at_least"), least, f"at least {least}"
    if "fact" in condition and "op" in condition:
        for other in OTHER_OPS.get(condition["op"], ()):
            yield (*path, "op"), other, f"{condition['op']} to {other}"
    if "value" in condition:
        yield from _values(condition["value"], (*path, "value"), thresholds)


def _action_changes(
    action: dict[str, Any], path: Path, thresholds: Mapping[str, Threshold]
) -> Iterator[tuple[Path, Any, str]]:
    for key, value in action.items():
        if key == "severity":
            other = SEVERITIES[(SEVERITIES.index(value) + 1) % len(SEVERITIES)]
            yield (*path, key), other, f"{value} to {other}"
        elif key not in NOT_EXPECTABLE and key != "slot":
            yield from _values(value, (*path, key), thresholds)


def _changed(data: dict[str, Any], path: Path, value: Any) -> dict[str, Any]:
    """Return a copy with one place changed."""
    result = copy.deepcopy(data)
    place: Any = result
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = copy.deepcopy(value)
    return result


def mutants(rule: Rule, thresholds: Mapping[str, Threshold]) -> Iterator[Mutant]:
    """Yield all mutants of a rule that are still rules."""
    data = rule.model_dump(by_alias=True, exclude_unset=True)
    changes: list[tuple[Path, Any, str]] = []
    for part in ("when", "then"):
        items, each = data[part], _condition_changes if part == "when" else _action_changes
        for index, item in enumerate(items):
            if len(items) > 1:
                changes.append(((part,), items[:index] + items[index + 1 :], f"{part} {index + 1} dropped"))
            changes += [
                (path, value, f"{part} {index + 1}: {said}")
                for path, value, said in each(item, (part, index), thresholds)
            ]
    for path, value, said in changes:
        try:
            yield Mutant(Rule.model_validate(_changed(data, path, value)), said)
        except ValidationError:
            continue


def caught(mutant: Mutant, loaded: LoadedRules, engine: Engine, words: Vocabulary, file: CaseFile) -> bool:
    """Say whether one of the cases of a rule fails on a mutant of it."""
    origin = loaded.merged.rules[file.rule][1]
    changed = replace(loaded, merged=replace(loaded.merged, rules={file.rule: (mutant.rule, origin)}))
    return any(not run_case(changed, engine, words, file, index).passed for index in range(len(file.cases)))


def survivors(ids: list[str] | None = None) -> tuple[int, list[str]]:
    """Return the number of mutants of the shipped rules, and those that no case catches."""
    words = vocabulary(probes().values())
    loaded = load_rules(None, words, operators(), probes())
    files, _ = read_cases(loaded.merged, words, ids=ids)
    engine = make_engine("compiled", words)
    count, alive = 0, []
    for file in files:
        if file.rule not in loaded.merged.rules:
            continue
        for mutant in mutants(loaded.merged.rules[file.rule][0], loaded.base.thresholds):
            count += 1
            if not caught(mutant, loaded, engine, words, file):
                alive.append(f"{file.rule}: {mutant.change}")
    return count, alive


if __name__ == "__main__":
    total, alive = survivors(sys.argv[1:] or None)
    for line in alive:
        print(line)
    print(f"{total} mutants, {len(alive)} survive")
    sys.exit(bool(alive))
