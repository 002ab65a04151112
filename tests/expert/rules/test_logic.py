"""What the checks conclude from conditions is true for every fact: compared with evaluation on random facts."""

from __future__ import annotations

import random

import pytest

from expert.facts import Fact
from expert.rules.checks.context import Context, RuleScope
from expert.rules.checks.logic import Conjunction, of_rule
from expert.rules.layers import Merged, Origin
from expert.rules.margin import Judge
from expert.rules.model import Rule, RuleBase
from expert.rules.reader import Document

NUMBERS = (-3, 0, 2, 2.5, 3)
OPS = ("lt", "le", "gt", "ge", "eq", "ne", "abs_lt", "abs_le", "abs_gt", "abs_ge")
FIELDS = (("brightness", "offset_dn", NUMBERS), ("trial", "number", (1, 2, 3)), ("side", "mean_dn", (0, 2, 3)))
ROUNDS = 2000


def plain(source: random.Random) -> dict:
    """Return a condition without others in it."""
    kind = source.random()
    if kind < 0.15:
        return {"finding": source.choice("ab"), "at_least": source.choice(["minor", "major"])}
    if kind < 0.3:
        side = source.choice(["left", "right"])
        return {"fact": "side", "field": "side", "op": source.choice(["eq", "ne"]), "value": side}
    fact, field, values = source.choice(FIELDS)
    two = sorted(source.choices(values, k=2))
    op = source.choice([*OPS, *OPS, "between", "in", "not_in", "present", "exists"])
    if op == "exists":
        return {"fact": fact}
    value = {"between": two, "in": two, "not_in": two, "present": None}.get(op, two[0])
    return {"fact": fact, "field": field, "op": op, **({} if value is None else {"value": value})}


def condition(source: random.Random) -> dict:
    kind = source.random()
    if kind < 0.15:
        return {"not": plain(source)}
    return {"any_of": [plain(source), plain(source)]} if kind < 0.3 else plain(source)


def conditions(source: random.Random) -> list[dict]:
    return [condition(source) for _ in range(source.randint(1, 4))]


def some_facts(source: random.Random) -> frozenset[Fact]:
    facts = {Fact.of("finding", name=name, severity=source.choice(["minor", "major"])) for name in "ab"}
    facts |= {Fact.of("side", side=side, mean_dn=source.choice([0, 1, 2, 3])) for side in ("left", "right")}
    facts.add(Fact.of("brightness", offset_dn=source.choice((*NUMBERS, 2.2, -2))))
    facts.add(Fact.of("trial", number=source.randint(1, 4)))
    return frozenset(fact for fact in sorted(facts) if source.random() < 0.8)


@pytest.fixture(scope="module")
def read(words, operators, probes):
    merged = Merged({}, {}, {}, {}, frozenset(), frozenset(), frozenset())
    context = Context(merged, words, operators, probes)

    def build(when) -> tuple[Rule, Conjunction]:
        rule = Rule.model_validate(
            {"id": "COR001", "name": "x", "stage": "correction", "when": when, "then": [{"derive": "c"}],
             "because": "a reason long enough", "references": ["none"]}
        )  # fmt: skip
        return rule, of_rule(RuleScope.of(context, rule, Origin(Document("x", None, ""), ())))

    return build


def fires(rule, words, facts) -> bool:
    return Judge(RuleBase(), words, facts).first_failing(rule) is None


def test_what_is_called_impossible_never_holds(read, words):
    source, seen = random.Random(1), 0
    for _ in range(ROUNDS):
        rule, conjunction = read(conditions(source))
        if conjunction.clash is not None:
            seen += 1
            assert not fires(rule, words, some_facts(source)), rule.when
    assert seen > 100


def test_an_implied_rule_fires_whenever_the_other_does(read, words):
    source, seen = random.Random(2), 0
    for _ in range(ROUNDS):
        (first, mine), (second, its) = read(conditions(source)), read([condition(source)])
        if mine.clash is None and mine.implies(its):
            for _ in range(20):
                facts = some_facts(source)
                if fires(first, words, facts):
                    seen += 1
                    assert fires(second, words, facts), (first.when, second.when)
    assert seen > 100


def test_rules_that_exclude_each_other_never_fire_together(read, words):
    source, seen = random.Random(3), 0
    for _ in range(ROUNDS):
        (first, mine), (second, its) = read(conditions(source)), read(conditions(source))
        if mine.excludes(its):
            seen += 1
            facts = some_facts(source)
            assert not (fires(first, words, facts) and fires(second, words, facts)), (first.when, second.when)
    assert seen > 100


LEFT = {"fact": "side", "field": "side", "op": "eq", "value": "left"}
MEAN = {"fact": "side", "field": "mean_dn"}
OFFSET = {"fact": "brightness", "field": "offset_dn"}


@pytest.mark.parametrize(
    ("one", "two", "excluded"),
    [
        ([{**OFFSET, "op": "gt", "value": 3}], [{**OFFSET, "op": "le", "value": 3}], True),
        ([{**OFFSET, "op": "ge", "value": 3}], [{**OFFSET, "op": "le", "value": 3}], False),
        ([{**OFFSET, "op": "abs_ge", "value": 6}], [{**OFFSET, "op": "between", "value": [-5, 5]}], True),
        ([{"finding": "a", "at_least": "major"}], [{"not": {"finding": "a"}}], True),
        ([{"finding": "a"}], [{"not": {"finding": "a", "at_least": "major"}}], False),
        (
            [{"fact": "task", "field": "profile", "op": "in", "value": ["balanced", "best"]}],
            [{"fact": "task", "field": "profile", "op": "eq", "value": "fast"}],
            True,
        ),
        (  # two facts of one template
            [{"fact": "side", "field": "mean_dn", "op": "gt", "value": 3}],
            [{"fact": "side", "field": "mean_dn", "op": "lt", "value": 3}],
            False,
        ),
        (  # one fact, because its key is given
            [LEFT, {**MEAN, "op": "gt", "value": 3}],
            [{**LEFT, "as": "s"}, {**MEAN, "as": "s", "op": "lt", "value": 3}],
            True,
        ),
    ],
)
def test_which_rules_exclude_each_other(read, one, two, excluded):
    (_, mine), (_, its) = read(one), read(two)
    assert mine.excludes(its) is its.excludes(mine) is excluded
