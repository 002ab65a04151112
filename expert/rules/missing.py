"""Propose cases at the limits that no case of a rule touches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

from expert.facts import Fact, FieldInfo, Scalar, Vocabulary
from expert.firing import Engine, Firing
from expert.rules.cases import CaseFile, facts_of
from expert.rules.checks.context import walk
from expert.rules.evaluate import Evaluator
from expert.rules.load import LoadedRules
from expert.rules.margin import UNORDERED, Judge
from expert.rules.model import Comparison, Rule
from expert.rules.reader import Path


@dataclass(frozen=True)
class ProposedCase:
    """A case made from a firing one by moving one value to its limit.

    `fires` is what the rule does as it is written; whether it should is for its author to say.
    """

    rule: str
    name: str
    facts: tuple[Fact, ...]
    fires: bool
    expect: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        """Write it as an item of a case file."""
        measured = [fact for fact in self.facts if fact.template != "finding"]
        lines = [f"- name: {_flow(self.name)}"]
        if measured:
            lines += ["  facts:", *(f"    - {_flow({'fact': item.template, **item.as_dict()})}" for item in measured)]
        findings = [_finding(fact) for fact in self.facts if fact.template == "finding"]
        if findings:
            lines.append(f"  findings: {_flow(findings)}")
        lines.append(f"  fires: {str(self.fires).lower()}")
        if self.expect:
            lines.append(f"  expect: {_flow(dict(self.expect))}")
        return "\n".join(lines) + "\n"


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=float("inf"), allow_unicode=True)
    return str(text).removesuffix("...\n").strip()


def _finding(fact: Fact) -> str | dict[str, Scalar | None]:
    name, severity = str(fact.get("name")), fact.get("severity")
    return name if severity == "minor" else {"finding": name, "severity": severity}


def missing_cases(
    loaded: LoadedRules, engine: Engine, vocabulary: Vocabulary, files: Iterable[CaseFile]
) -> tuple[list[ProposedCase], list[str]]:
    """Return a case for every limit that no case touches, and a sentence for every one for which none can be made.

    Parameters
    ----------
    loaded : LoadedRules
    engine : Engine
    vocabulary : mapping
        For the ranges of fields.
    files : iterable of CaseFile
        Only the rules of these files are looked at.
    """
    found: list[ProposedCase] = []
    impossible: list[str] = []
    for file in files:
        if file.rule in loaded.merged.rules:
            cases, unmade = _Search(loaded, engine, vocabulary, file).run()
            found += cases
            impossible += unmade
    return found, impossible


class _Search:
    """Looks for the untouched limits of one rule."""

    def __init__(self, loaded: LoadedRules, engine: Engine, vocabulary: Vocabulary, file: CaseFile) -> None:
        self.rule: Rule = loaded.merged.rules[file.rule][0]
        self.base = loaded.base.model_copy(update={"rules": [self.rule]})
        self.engine, self.vocabulary = engine, vocabulary
        self.evaluator = Evaluator(vocabulary, self.base.thresholds)
        self.given = [facts_of(case) for case, _ in file.cases]

    def run(self) -> tuple[list[ProposedCase], list[str]]:
        """Return the proposed cases, and what is missing but cannot be proposed."""
        found: list[ProposedCase] = []
        impossible: list[str] = []
        touched = {
            item for facts in self.given for item in Judge(self.base, self.vocabulary, facts).at_limits(self.rule)
        }
        for condition, path, _ in walk(self.rule):
            if not isinstance(condition, Comparison) or condition.op in UNORDERED:
                continue
            ranged = condition.op == "between"
            if not ranged and any(place == path for place, _ in touched):
                continue
            made = [case for case, limit in self._made(condition) if (path, limit) not in touched]
            found += made
            if not made and not (ranged and any(place == path for place, _ in touched)):
                impossible.append(f"{self.rule.id}, {_place(path)}: no firing case can be moved to the limit")
        return found, impossible

    def _made(self, condition: Comparison) -> Iterator[tuple[ProposedCase, Scalar]]:
        """Yield a case per limit of a comparison, made from the first firing case that has its fact."""
        for facts in self.given:
            fact, limits = self._at(condition, facts)
            if fact is None:
                continue
            for limit in limits:
                info = self.vocabulary[condition.fact].fields[condition.field or ""]
                value = _within(info, condition, fact.get(info.name), limit)
                if value is None:
                    continue
                moved = Fact.of(fact.template, **{**fact.as_dict(), info.name: value})
                changed = tuple(sorted(moved if item == fact else item for item in facts))
                unit = "" if info.unit == "1" else f" {info.unit}"
                name = f"{info.name} of {condition.fact} at its limit {value:g}{unit}"
                firings = self._firings(changed)
                expect = self._expectation(firings[0]) if firings else {}
                yield ProposedCase(self.rule.id, name, changed, bool(firings), expect), limit
            return

    def _firings(self, facts: Iterable[Fact]) -> Sequence[Firing]:
        return self.engine.infer(self.base, self.rule.stage, facts).firings

    def _expectation(self, firing: Firing) -> dict[str, Any]:
        """Return what a case has to expect of the first action of a firing."""
        for resolved in firing.actions:
            action: Any = self.rule.then[resolved.index]
            found = {resolved.kind: getattr(action, resolved.kind)}
            found.update({name: getattr(action, name) for name in ("parameter", "severity") if hasattr(action, name)})
            values = dict(resolved.values)
            return {**found, **(values if "to" in values else {"with": values} if values else {})}
        return {}

    def _at(self, condition: Comparison, facts: frozenset[Fact]) -> tuple[Fact | None, tuple[Scalar, ...]]:
        """Return the fact that a comparison speaks of in a firing case, and the limits there."""
        for firing in self._firings(facts):
            bindings = dict(firing.bindings)
            candidates = [fact for fact in sorted(facts) if fact.template == condition.fact]
            fact = bindings.get(condition.name) or next(iter(candidates), None)
            if fact is None:
                continue
            _, limit = self.evaluator.sides(condition, {**bindings, condition.name: fact})
            return fact, limit if isinstance(limit, tuple) else () if limit is None else (limit,)
        return None, ()


def _within(info: FieldInfo, condition: Comparison, old: Scalar | None, limit: Scalar) -> int | float | None:
    """Return the value at a limit as the field can have it, on the side of zero where it was; None if it cannot."""
    if isinstance(limit, bool | str) or info.kind not in ("number", "integer"):
        return None
    value = -limit if condition.op.startswith("abs_") and isinstance(old, int | float) and old < 0 else limit
    if (info.ge is not None and value < info.ge) or (info.le is not None and value > info.le):
        return None
    if info.kind == "integer":
        return int(value) if float(value).is_integer() else None
    return float(value)


def _place(path: Path) -> str:
    return ".".join(str(part + 1) if isinstance(part, int) else part for part in path)
