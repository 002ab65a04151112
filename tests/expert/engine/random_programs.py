"""Random rule bases and facts over the whole language, and a slow, literal interpreter of its semantics."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from expert.facts import SEVERITIES, Fact, FieldInfo, TemplateInfo
from expert.firing import Firing
from expert.rules.evaluate import Evaluator, finding_of, matches_finding
from expert.rules.model import AnyOf, Comparison, Exists, FindingCondition, ForAll, Not, RuleBase, Stage
from expert.rules.strata import conditions_of, stratify
from modules.operator import Cost, Operator, OperatorParams

FIELDS = {"x": "number", "y": "number", "n": "integer", "s": "text", "t": "boolean", "sx": "number"}
TEMPLATES = ("a", "b", "c")
ALIASES = {"a": ("a", "p", "q"), "b": ("b", "r"), "c": ("c", "class", "k-1")}
NUMBERS = (-2, -1, 0, 0.5, 1, 1.5, 2)
TEXTS = ("u", "v", "w")
DEPTH = 8  # of chains of findings
NUMERIC = (
    "eq",
    "ne",
    "lt",
    "le",
    "gt",
    "ge",
    "abs_lt",
    "abs_le",
    "abs_gt",
    "abs_ge",
    "significantly_gt",
    "significantly_lt",
)
STAGE: Stage = "correction"
OPERATORS = ("correction.op", "correction.other")
SCORES = (0.5, 0.5, 0.7)  # ties are frequent


def small_vocabulary() -> dict[str, TemplateInfo]:
    """Return three templates alike, in which `sx` is the uncertainty of `x`."""
    fields = {
        name: FieldInfo(name, kind, "1", name, sigma="sx" if name == "x" else None)  # type: ignore[arg-type]
        for name, kind in FIELDS.items()
    }
    return {name: TemplateInfo(name, name, fields, ()) for name in TEMPLATES}


class AnyParams(OperatorParams):
    """Parameters that take whatever a rule computes."""

    k: Any = 0
    m: Any = 0
    step: float = 1.0


def small_catalog() -> dict[str, Operator]:
    """Return two operators for one slot."""
    cost = Cost()
    return {name: Operator(name, "radiometry", AnyParams, lambda state, _: state, cost, "test") for name in OPERATORS}


class Generator:
    """Draws rule bases and facts; the same source of randomness gives the same ones."""

    def __init__(self, source: random.Random) -> None:
        self.r = source

    def facts(self) -> list[Fact]:
        found = [self._fact(template) for template in TEMPLATES for _ in range(self.r.randint(0, 3))]
        for _ in range(self.r.choice((0, 0, 1))):
            found.append(Fact.of("finding", name=self._finding(DEPTH), severity=self.r.choice(SEVERITIES)))
        self.r.shuffle(found)
        return found

    def rule_base(self) -> RuleBase:
        wild = self.r.random() < 0.1  # may be cyclic
        rules = [self._rule(number, wild) for number in range(self.r.randint(1, 10))]
        if self.r.random() < 0.3:
            rules += [self._link(level) for level in range(DEPTH)]
        thresholds = {"low": {"value": 0.5, "because": "test"}, "high": {"value": 1, "because": "test"}}
        slots = {STAGE: [{"slot": "radiometry", "default": OPERATORS[0], "because": "test"}]}
        return RuleBase.model_validate({"rules": rules, "thresholds": thresholds, "slots": slots})

    def _fact(self, template: str) -> Fact:
        fields: dict[str, Any] = {}
        for name, kind in FIELDS.items():
            if self.r.random() < 0.75:
                fields[name] = self._scalar(kind)
        if self.r.random() < 0.1:  # as no probe gives it: NaN is no value
            return Fact(template, tuple(sorted({**fields, "y": float("nan")}.items())))
        return Fact.of(template, **fields)

    def _scalar(self, kind: str) -> Any:
        if kind == "text":
            return self.r.choice(TEXTS)
        return self.r.random() < 0.5 if kind == "boolean" else self.r.choice(NUMBERS)

    def _finding(self, below: int) -> str:
        return f"f{self.r.randrange(max(below, 1))}"

    def _link(self, level: int) -> dict[str, Any]:
        when: list[Any] = [{"finding": f"f{level - 1}"}] if level else [{"fact": self.r.choice(TEMPLATES)}]
        return self._frame(f"LNK{level:03d}", when, [{"derive": f"f{level}", "severity": self.r.choice(SEVERITIES)}])

    def _frame(self, name: str, when: list[Any], then: list[Any]) -> dict[str, Any]:
        return {
            "id": name, "name": "test", "stage": STAGE, "when": when, "then": then,
            "because": "because of a test", "references": ["test"],
        }  # fmt: skip

    def _rule(self, number: int, wild: bool) -> dict[str, Any]:
        level = self.r.randrange(DEPTH + 1)
        derives = level < DEPTH and self.r.random() < 0.8
        self.any_finding = not derives or wild
        self.positive, self.negative = (DEPTH, DEPTH) if wild or not derives else (level + 1, level)
        when = self._conditions(0, False, self.r.randint(1, 4))
        then: list[Any] = []
        if derives:
            kind = self.r.choice(("derive", "assess"))
            then.append({kind: f"f{level}", "severity": self.r.choice(SEVERITIES)})
        if self.r.random() < 0.6 or not then:
            kind, score = self.r.choice(("choose", "choose", "repair")), self.r.choice(SCORES)
            wanted = {"k": self._operand(2), "m": self._operand(1)}
            then.append({kind: self.r.choice(OPERATORS), "with": wanted, "score": score})
        if self.r.random() < 0.3:
            then.append(
                {"set": "correction.op", "parameter": "k", "to": self._operand(2), "score": self.r.choice(SCORES)}
            )
        if self.r.random() < 0.1:
            then.append({"exclude": self.r.choice(OPERATORS)})
        if self.r.random() < 0.1:
            then.append({"adjust": "correction.op", "parameter": "step", "by": 0.5, "at_most": 2.0})
        if self.r.random() < 0.1:
            then.append({"measure": "measurement.something"})
        return {**self._frame(f"RUL{number:03d}", when, then), "priority": self.r.choice((100, 100, 200))}

    def _conditions(self, depth: int, negated: bool, count: int) -> list[Any]:
        return [self._condition(depth, negated) for _ in range(count)]

    def _group(self, depth: int, negated: bool) -> Any:
        conditions = self._conditions(depth, negated, self.r.choice((1, 1, 2, 3)))
        return conditions[0] if len(conditions) == 1 and self.r.random() < 0.7 else conditions

    def _condition(self, depth: int, negated: bool) -> dict[str, Any]:
        draw = self.r.random()
        if depth >= 3 or draw < 0.5:
            return self._comparison()
        if draw < 0.6:
            below = self.negative if negated else self.positive
            if below == 0:
                return self._comparison()
            return {"finding": self._finding(below), "at_least": self.r.choice(SEVERITIES)}
        if draw < 0.72:
            return {"not": self._group(depth + 1, True)}
        if draw < 0.82:
            return {"any_of": [self._group(depth + 1, negated) for _ in range(self.r.randint(1, 3))]}
        if draw < 0.9:
            return {"exists": self._group(depth + 1, negated)}
        if draw < 0.97:
            where = self._conditions(depth + 1, True, self.r.randint(1, 2))
            return {"for_all": {"where": where, "then": self._conditions(depth + 1, True, self.r.randint(1, 2))}}
        if self.any_finding:
            return {"fact": "finding", "as": "g", "field": "name", "op": "eq", "value": self._finding(DEPTH)}
        return self._comparison()

    def _comparison(self) -> dict[str, Any]:
        template = self.r.choice(TEMPLATES)
        found: dict[str, Any] = {"fact": template}
        if self.r.random() < 0.6:
            found["as"] = self.r.choice(ALIASES[template])
        if self.r.random() < 0.02:
            found["as"] = "p"  # perhaps of another template
        if self.r.random() < 0.15:
            return found
        field = self.r.choice(tuple(FIELDS))
        found["field"] = field
        found.update(self._limit(FIELDS[field]))
        return found

    def _limit(self, kind: str) -> dict[str, Any]:
        draw = self.r.random()
        if draw < 0.1:
            return {"op": self.r.choice(("present", "absent"))}
        if draw < 0.25:
            members = [self._scalar(kind) for _ in range(self.r.randint(1, 3))]
            return {"op": self.r.choice(("in", "not_in")), "value": members}
        if kind in ("text", "boolean"):
            return {"op": self.r.choice(("eq", "ne")), "value": self._mixed(kind)}
        if draw < 0.35:
            return {"op": "between", "value": [self.r.choice((-1, 0)), self.r.choice((1, {"threshold": "high"}))]}
        return {"op": self.r.choice(NUMERIC), "value": self._operand(2)}

    def _mixed(self, kind: str) -> Any:
        if self.r.random() < 0.3:
            return {"field": f"{self._alias()}.{'s' if kind == 'text' else 't'}"}
        return self._scalar(kind if self.r.random() < 0.9 else "number")

    def _alias(self) -> str:
        return self.r.choice(("a", "p", "q", "b", "r", "c", "class"))

    def _operand(self, depth: int) -> Any:
        draw = self.r.random()
        if draw < 0.45 or depth == 0:
            return self.r.choice(NUMBERS)
        if draw < 0.8:
            return {"field": f"{self._alias()}.{self.r.choice(('x', 'y', 'n', 's'))}"}
        if draw < 0.88:
            return {"threshold": self.r.choice(("low", "high", "unknown"))}
        if draw < 0.9:
            return {self.r.choice(("round", "floor", "ceil")): self._operand(depth - 1)}
        calculations = (("add", 2), ("sub", 2), ("mul", 3), ("div", 2), ("min", 2), ("max", 3), ("clamp", 3))
        name, count = self.r.choice(calculations)
        return {name: [self._operand(depth - 1) for _ in range(count)]}


class Literal:
    """The semantics of the language read aloud: every combination of facts is tried for every rule."""

    def __init__(self, rules: RuleBase, vocabulary: Mapping[str, TemplateInfo]) -> None:
        self.rules = rules
        self.evaluator = Evaluator(vocabulary, rules.thresholds)

    def infer(self, facts: Sequence[Fact]) -> tuple[set[Firing], frozenset[Fact]]:
        known = set(facts)
        firings: set[Firing] = set()
        for layer in stratify(self.rules.of_stage(STAGE)):
            before = -1
            while before != len(known):
                before = len(known)
                for rule in layer:
                    for bindings in list(self.bindings(rule.when, {}, known)):
                        actions = self.evaluator.actions(rule.then, bindings)
                        firings.add(Firing(rule.id, tuple(sorted(bindings.items(), key=lambda item: item[0])), actions))
                        known |= {fact for fact in map(finding_of, rule.then) if fact}
        return firings, frozenset(known)

    def bindings(self, conditions: Sequence[Any], outer: Mapping[str, Fact], known: set[Fact]) -> Iterator[Any]:
        comparisons = [item for item in conditions if isinstance(item, Comparison)]
        aliases = sorted({item.name for item in comparisons} - outer.keys())
        for facts in itertools.product(known, repeat=len(aliases)):
            found = {**outer, **dict(zip(aliases, facts, strict=True))}
            if all(self.holds(condition, found, known) for condition in conditions):
                yield found

    def holds(self, condition: Any, found: Mapping[str, Fact], known: set[Fact]) -> bool:
        if isinstance(condition, Comparison):
            return self.evaluator.comparison(condition, found)
        if isinstance(condition, FindingCondition):
            return any(matches_finding(condition, fact) for fact in known)
        if isinstance(condition, Not):
            return not self.some(conditions_of(condition.not_), found, known)
        if isinstance(condition, Exists):
            return self.some(conditions_of(condition.exists), found, known)
        if isinstance(condition, AnyOf):
            return any(self.some(conditions_of(branch), found, known) for branch in condition.any_of)
        if not isinstance(condition, ForAll):
            raise TypeError(condition)
        body = condition.for_all
        return all(self.some(body.then, each, known) for each in self.bindings(body.where, found, known))

    def some(self, conditions: Sequence[Any], found: Mapping[str, Fact], known: set[Fact]) -> bool:
        return next(self.bindings(conditions, found, known), None) is not None
