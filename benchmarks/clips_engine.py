"""The same rules on CLIPS, to compare firings and times with; clipspy is a development dependency only.

What CLIPS can express of the language: comparisons of one fact and between facts, arithmetic, findings with severity,
and groups that are negated or quantified, nested. A firing is a rule and the facts its aliases are bound to; the
values of its actions are not computed. Layers of rules become salience.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import clips

from expert.engine.common import canonical_facts
from expert.facts import SEVERITIES, Fact, Scalar, Vocabulary
from expert.rules.evaluate import SIGNIFICANT_SIGMAS, finding_of, operand_aliases
from expert.rules.model import (
    AnyOf,
    Calculation,
    Comparison,
    Condition,
    Exists,
    FieldRef,
    FindingCondition,
    ForAll,
    Not,
    Rule,
    RuleBase,
    Stage,
    Threshold,
    ThresholdRef,
)
from expert.rules.strata import conditions_of, stratify

Fired = frozenset[tuple[str, tuple[tuple[str, Fact], ...]]]
ABSENT = "nil"
FALSE = "(neq 1 1)"

# Total functions, as in the language: what cannot be computed is absent, and a comparison with that is false.
FUNCTIONS = (
    "(deffunction cmp-kind (?a ?b) (or (and (numberp ?a) (numberp ?b))"
    " (and (not (numberp ?a)) (not (numberp ?b)) (neq ?a nil) (neq ?b nil) (eq (stringp ?a) (stringp ?b)))))",
    "(deffunction is-eq (?a ?b) (and (cmp-kind ?a ?b) (if (numberp ?a) then (= ?a ?b) else (eq ?a ?b))))",
    "(deffunction is-ne (?a ?b) (and (cmp-kind ?a ?b) (if (numberp ?a) then (<> ?a ?b) else (neq ?a ?b))))",
    "(deffunction c-add (?a ?b) (if (and (numberp ?a) (numberp ?b)) then (+ ?a ?b) else nil))",
    "(deffunction c-sub (?a ?b) (if (and (numberp ?a) (numberp ?b)) then (- ?a ?b) else nil))",
    "(deffunction c-mul (?a ?b) (if (and (numberp ?a) (numberp ?b)) then (* ?a ?b) else nil))",
    "(deffunction c-div (?a ?b) (if (and (numberp ?a) (numberp ?b) (<> ?b 0)) then (/ (float ?a) ?b) else nil))",
    "(deffunction c-min (?a ?b) (if (and (numberp ?a) (numberp ?b)) then (min ?a ?b) else nil))",
    "(deffunction c-max (?a ?b) (if (and (numberp ?a) (numberp ?b)) then (max ?a ?b) else nil))",
)
SYMBOLS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">="}


class Inexpressible(ValueError):
    """CLIPS cannot say this, or not in the same sense."""


class ClipsEngine:
    """One stage of a rule base on CLIPS.

    Parameters
    ----------
    vocabulary : mapping of str to TemplateInfo
        Templates that rules may speak of.
    rules : RuleBase
    stage : str

    Notes
    -----
    clipspy never frees facts: make a new one for every fact set when there are many.
    """

    def __init__(self, vocabulary: Vocabulary, rules: RuleBase, stage: Stage) -> None:
        self._words = vocabulary
        self._thresholds = rules.thresholds
        self._aliases: dict[str, tuple[str, ...]] = {}
        self._env = clips.Environment()
        fields = {name: tuple(info.fields) for name, info in vocabulary.items()}
        fields["finding"] = ("name", "severity")
        self._fields = fields
        for template, names in fields.items():
            slots = " ".join(f"(slot f-{name} (default {ABSENT}))" for name in names)
            self._env.build(f"(deftemplate t-{template} (slot id) {slots})")
        self._env.build("(deftemplate fired (slot rule) (multislot ids))")
        for function in FUNCTIONS:
            self._env.build(function)
        layers = stratify(rules.of_stage(stage))
        for level, members in enumerate(layers):
            for rule in members:
                self._env.build(self._rule(rule, len(layers) - level))

    def infer(self, facts: Iterable[Fact]) -> Fired:
        """Return what fires on these facts."""
        known: dict[str, Fact] = {}
        self._env.reset()
        for index, fact in enumerate(canonical_facts(facts)):
            name = _finding_id(fact) if fact.template == "finding" else f"i{index}"
            known[name] = fact
            slots = " ".join(f"(f-{field} {_literal(value)})" for field, value in fact.values.items())
            self._env.assert_string(f"(t-{fact.template} (id {name}) {slots})")
        self._env.run()
        found = []
        for item in self._env.facts():
            if item.template.name == "t-finding" and item["id"] not in known:
                known[item["id"]] = Fact.of("finding", name=item["f-name"], severity=item["f-severity"])
        for item in self._env.facts():
            if item.template.name == "fired":
                rule = str(item["rule"])
                bound = zip(self._aliases[rule], (known[name] for name in item["ids"]), strict=True)
                found.append((rule, tuple(bound)))
        return frozenset(found)

    def _rule(self, rule: Rule, salience: int) -> str:
        aliases = tuple(sorted({item.name for item in rule.when if isinstance(item, Comparison)}))
        self._aliases[rule.id] = aliases
        ids = " ".join(f"?{_variable(alias)}-id" for alias in aliases)
        actions = [f"(assert (fired (rule {rule.id}) (ids {ids})))"]
        for finding in filter(None, map(finding_of, rule.then)):
            name, severity = finding.get("name"), finding.get("severity")
            slots = f'(id {_finding_id(finding)}) (f-name "{name}") (f-severity "{severity}")'
            actions.append(f"(assert (t-finding {slots}))")
        left = " ".join(self._group(rule.when, {}))
        return f"(defrule {rule.id} (declare (salience {salience})) {left} => {' '.join(actions)})"

    def _group(self, conditions: Sequence[Condition], outer: Mapping[str, str]) -> list[str]:
        """Return the conditional elements of conditions that hold together; `outer` gives aliases their templates."""
        comparisons = [item for item in conditions if isinstance(item, Comparison)]
        scope = dict(outer)
        found = []
        for item in comparisons:
            if item.name in scope:
                continue
            scope[item.name] = item.fact
            own = [other for other in comparisons if other.name == item.name and other.fact == item.fact]
            simple = [other for other in own if other.op in SYMBOLS and _is_plain(other.value)]
            found.append(self._pattern(item, simple))
            comparisons = [other for other in comparisons if other not in simple]
        tests = [self._comparison(item, scope) for item in comparisons]
        found += [f"(test {test})" for test in tests if test]
        for condition in conditions:
            if not isinstance(condition, Comparison):
                found.append(self._nested(condition, scope))
        return found

    def _pattern(self, item: Comparison, simple: Sequence[Comparison]) -> str:
        """Return the pattern of an alias: all its fields bound to variables, comparisons with constants inside."""
        name = _variable(item.name)
        slots = [f"(id ?{name}-id)"]
        for field in self._fields[item.fact]:
            variable = f"?{name}-{field}"
            limits = [f"({SYMBOLS[one.op]} {variable} {_literal(one.value)})" for one in simple if one.field == field]
            check = f"&:(and (numberp {variable}) {' '.join(limits)})" if limits else ""
            slots.append(f"(f-{field} {variable}{check})")
        return f"(t-{item.fact} {' '.join(slots)})"

    def _nested(self, condition: Condition, scope: Mapping[str, str]) -> str:
        if isinstance(condition, FindingCondition):
            least = SEVERITIES[SEVERITIES.index(condition.at_least) :]
            names = "|".join(f'"{severity}"' for severity in least)
            return f'(exists (t-finding (f-name "{condition.finding}") (f-severity {names})))'
        if isinstance(condition, Not):
            return _negated(self._all(conditions_of(condition.not_), scope))
        if isinstance(condition, Exists):
            return _existing(self._all(conditions_of(condition.exists), scope))
        if isinstance(condition, AnyOf):
            branches = [_existing(self._all(conditions_of(branch), scope)) for branch in condition.any_of]
            return branches[0] if len(branches) == 1 else f"(or {' '.join(branches)})"
        if isinstance(condition, ForAll):
            where = self._group(condition.for_all.where, scope)
            named = {item.name: item.fact for item in condition.for_all.where if isinstance(item, Comparison)}
            then = self._all(condition.for_all.then, {**named, **scope})
            return f"(not (and {' '.join(where)} {_negated(then)}))"
        raise Inexpressible(type(condition).__name__)

    def _all(self, conditions: Sequence[Condition], scope: Mapping[str, str]) -> str:
        parts = self._group(conditions, scope) or [f"(test (not {FALSE}))"]
        return parts[0] if len(parts) == 1 else f"(and {' '.join(parts)})"

    def _comparison(self, item: Comparison, scope: Mapping[str, str]) -> str:
        if scope[item.name] != item.fact:
            return FALSE
        if item.field is None:
            return "" if item.op == "present" else FALSE
        value = f"?{_variable(item.name)}-{item.field}"
        if item.op in ("present", "absent"):
            return f"({'neq' if item.op == 'present' else 'eq'} {value} {ABSENT})"
        if isinstance(item.value, list):
            return self._members(item.op, value, [self._operand(each, scope) for each in item.value])
        limit = self._operand(item.value, scope)
        if item.op in ("eq", "ne"):
            return f"(is-{item.op} {value} {limit})"
        if limit == ABSENT or limit in ("TRUE", "FALSE") or limit.startswith('"'):
            return FALSE  # no number
        kinds = f"(numberp {value}) (numberp {limit})"
        if item.op.startswith("significantly"):
            info = self._words[item.fact].fields[item.field]
            if info.sigma is None:
                return FALSE
            sigma = f"?{_variable(item.name)}-{info.sigma}"
            above = item.op == "significantly_gt"
            edge = f"({'-' if above else '+'} {value} (* {SIGNIFICANT_SIGMAS} {sigma}))"
            return f"(and {kinds} (numberp {sigma}) ({'>' if above else '<'} {edge} {limit}))"
        left = f"(abs {value})" if item.op.startswith("abs_") else value
        return f"(and {kinds} ({SYMBOLS[item.op.removeprefix('abs_')]} {left} {limit}))"

    def _members(self, op: str, value: str, members: Sequence[str]) -> str:
        if ABSENT in members:
            return FALSE
        if op == "between":
            low, high = members
            return f"(and (numberp {value}) (numberp {low}) (numberp {high}) (<= {low} {value}) (<= {value} {high}))"
        test, word = ("is-eq", "or") if op == "in" else ("is-ne", "and")
        tests = [f"({test} {value} {member})" for member in members]
        return tests[0] if len(tests) == 1 else f"({word} {' '.join(tests)})"

    def _operand(self, operand: Any, scope: Mapping[str, str]) -> str:
        if isinstance(operand, FieldRef):
            alias, _, field = operand.field.partition(".")
            known = alias in scope and field in self._fields[scope[alias]]
            return f"?{_variable(alias)}-{field}" if known else ABSENT
        if isinstance(operand, ThresholdRef):
            threshold: Threshold | None = self._thresholds.get(operand.threshold)
            return ABSENT if threshold is None else _literal(threshold.value)
        if isinstance(operand, Calculation):
            name, operands = operand.operation()
            parts = [self._operand(item, scope) for item in operands]
            if name == "clamp":
                return f"(c-min (c-max {parts[0]} {parts[1]}) {parts[2]})"
            if name not in ("add", "sub", "mul", "div", "min", "max"):
                raise Inexpressible(name)
            result = parts[0]
            for part in parts[1:]:
                result = f"(c-{name} {result} {part})"
            return result
        return _literal(operand)


def _negated(element: str) -> str:
    return f"(test (not {element[6:-1]}))" if element.startswith("(test ") else f"(not {element})"


def _existing(element: str) -> str:
    return element if element.startswith("(test ") else f"(exists {element})"


def _is_plain(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and not operand_aliases(value)


def _variable(alias: str) -> str:
    return "v-" + alias


def _finding_id(fact: Fact) -> str:
    return f"{fact.get('name')}-{fact.get('severity')}"


def _literal(value: Scalar | None) -> str:
    if value is None:
        return ABSENT
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    return f'"{value}"' if isinstance(value, str) else repr(value)
