"""Short cuts of the engines say the same as the comparison that they stand for."""

from __future__ import annotations

import pickle
import random

from random_programs import TEMPLATES, Generator, small_vocabulary

from expert.engine.alpha import Alphas
from expert.engine.gates import Gates
from expert.facts import Fact
from expert.rules.evaluate import Evaluator
from expert.rules.model import Comparison, Rule, Threshold

THRESHOLDS = {"low": Threshold(value=0.5, because="test"), "high": Threshold(value=1, because="test")}
EVALUATOR = Evaluator(small_vocabulary(), THRESHOLDS)


def drawn(seed: int) -> tuple[Comparison, list[Fact]]:
    generator = Generator(random.Random(seed))
    return Comparison.model_validate(generator._comparison()), generator.facts()


def test_an_alpha_condition_admits_what_its_comparison_holds_for() -> None:
    held = 0
    for seed in range(600):
        comparison, facts = drawn(seed)
        alpha = Alphas(EVALUATOR).of(comparison.fact, [comparison])
        for fact in facts:
            if fact.template == comparison.fact:
                expected = EVALUATOR.comparison(comparison, {comparison.name: fact})
                assert alpha.admits(fact) is expected, f"seed {seed}: {comparison!r} on {fact}"
                held += expected
    assert held > 100


def test_equal_conditions_of_different_aliases_are_one() -> None:
    alphas = Alphas(EVALUATOR)
    same = [
        Comparison.model_validate({"fact": "a", "as": alias, "field": "x", "op": "gt", "value": 1}) for alias in "pq"
    ]
    assert alphas.of("a", same[:1]) is alphas.of("a", same[1:])
    assert alphas.of("b", same[:1]) is not alphas.of("a", same[:1])
    own = [
        Comparison.model_validate(
            {"fact": "a", "as": alias, "field": "x", "op": "gt", "value": {"field": f"{alias}.y"}}
        )
        for alias in "pq"
    ]
    assert alphas.of("a", own[:1]) is not alphas.of("a", own[1:])


def test_a_gate_is_closed_exactly_where_no_fact_holds_one_comparison() -> None:
    closed = 0
    for seed in range(600):
        comparison, facts = drawn(seed)
        asking, forbidding = (rule_of(when) for when in (comparison, {"not": comparison}))
        gates = Gates([asking, forbidding], EVALUATOR)
        by_template = {name: [fact for fact in facts if fact.template == name] for name in TEMPLATES}
        passed = gates.open(by_template)
        held = any(EVALUATOR.comparison(comparison, {comparison.name: fact}) for fact in by_template[comparison.fact])
        for gate, rank in (*gates.asked[0], *gates.forbidden[1]):
            assert (rank < passed[gate]) is held, f"seed {seed}: {comparison!r} on {facts}"
            closed += not held
        assert (gates.asked[1], gates.forbidden[0]) == ((), ())
    assert closed > 100


def rule_of(condition: object) -> Rule:
    return Rule.model_validate(
        {
            "id": "RUL001", "name": "test", "stage": "correction", "when": [condition], "then": [{"derive": "f"}],
            "because": "because of a test", "references": ["test"],
        }
    )  # fmt: skip


def test_nan_and_infinity_are_no_values_of_a_fact() -> None:
    assert Fact.of("a", x=float("nan"), y=float("inf"), n=1) == Fact.of("a", n=1)
    raw = Fact("a", (("x", float("nan")), ("y", 2.0)))
    assert (raw.get("x"), raw.get("y"), dict(raw.numbers)) == (None, 2.0, {"y": 2.0})


def test_a_fact_travels_without_what_was_computed_for_it() -> None:
    fact = Fact.of("a", x=1.5, s="u", t=True)
    plain = pickle.dumps(fact)
    assert hash(fact) == hash(Fact.of("a", x=1.5, s="u", t=True))
    assert (fact.key, fact.numbers) == (fact.key, {"x": 1.5})
    assert pickle.dumps(fact) == plain
    assert pickle.loads(plain) == fact
