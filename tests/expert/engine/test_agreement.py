"""Both engines agree with each other, and with a literal reading of the semantics, on random programs."""

from __future__ import annotations

import os
import random

from hypothesis import given
from hypothesis import strategies as st
from random_programs import STAGE, Generator, Literal, small_vocabulary

from expert.engine.compiled import CompiledEngine
from expert.engine.experta_engine import ExpertaEngine
from expert.facts import Fact
from expert.firing import Firings
from expert.rules.model import RuleBase
from expert.rules.strata import CyclicNegation

CASES = int(os.environ.get("TERREX_CASES", "250"))  # more of them: TERREX_CASES=20000
VOCABULARY = small_vocabulary()


def outcome(engine: CompiledEngine | ExpertaEngine, rules: RuleBase, facts: list[Fact]) -> Firings | str:
    try:
        return engine.infer(rules, STAGE, facts)
    except CyclicNegation as error:
        return str(error)


def compare(source: random.Random, fact_sets: int = 2) -> int:
    """Compare both engines on one random program and several fact sets; return the number of firings."""
    generator = Generator(source)
    rules = generator.rule_base()
    compiled, experta = CompiledEngine(VOCABULARY), ExpertaEngine(VOCABULARY)
    fired = 0
    for _ in range(fact_sets):
        facts = generator.facts()
        expected = outcome(compiled, rules, facts)
        found = outcome(experta, rules, facts)
        assert repr_of(found) == repr_of(expected), f"{rules.model_dump_json(by_alias=True)}\n{facts}"
        fired += len(expected.firings) if isinstance(expected, Firings) else 0
    return fired


def repr_of(result: Firings | str) -> str:
    # By text, because True equals 1 and 1 equals 1.0.
    return result if isinstance(result, str) else f"{result.firings} {sorted(map(repr, result.facts))}"


def test_both_engines_return_the_same_firings_for_random_programs() -> None:
    fired = sum(compare(random.Random(seed)) for seed in range(CASES))
    assert fired > CASES, "the random programs hardly fire, so that they prove little"


@given(st.randoms(use_true_random=False))
def test_both_engines_return_the_same_firings_for_any_program(source: random.Random) -> None:
    compare(source, fact_sets=1)


def test_the_compiled_engine_follows_the_semantics_to_the_letter() -> None:
    for seed in range(CASES // 2):
        generator = Generator(random.Random(seed))
        rules, facts = generator.rule_base(), generator.facts()[:5]
        try:
            firings, known = Literal(rules, VOCABULARY).infer(facts)
        except CyclicNegation:
            continue
        result = CompiledEngine(VOCABULARY).infer(rules, STAGE, facts)
        assert set(result.firings) == firings, f"seed {seed}"
        assert result.facts == known
