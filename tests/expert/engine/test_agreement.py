"""Both engines agree with each other, with a literal reading of the semantics and with CLIPS, on random programs.

`make property-engines` runs the same with many more programs.
"""

from __future__ import annotations

import os
import random

from hypothesis import given
from hypothesis import strategies as st
from random_programs import STAGE, Generator, Literal, small_catalog, small_vocabulary

from benchmarks.clips_engine import ClipsEngine, Inexpressible
from expert.engine.compiled import CompiledEngine
from expert.engine.experta_engine import ExpertaEngine
from expert.facts import Fact
from expert.firing import Firings
from expert.plan import Directives, adjustments, settle
from expert.rules.model import RuleBase
from expert.rules.strata import CyclicNegation, with_sources

CASES = int(os.environ.get("TERREX_CASES", "250"))
VOCABULARY = small_vocabulary()
CATALOG = small_catalog()


def outcome(engine: CompiledEngine | ExpertaEngine, rules: RuleBase, facts: list[Fact]) -> Firings | str:
    try:
        return engine.infer(rules, STAGE, facts)
    except CyclicNegation as error:
        return str(error)


def plan(rules: RuleBase, result: Firings | str) -> str:
    """Return what is settled from firings; `ties` are frequent in the random programs."""
    if isinstance(result, str):
        return result
    wishes = Directives(adjustments=adjustments({rule.id: rule for rule in rules.rules}, result.firings))
    return settle(rules, STAGE, result.firings, CATALOG, wishes).model_dump_json()


def compare(source: random.Random, fact_sets: int = 2) -> int:
    """Compare both engines on one random program and several fact sets; return the number of firings."""
    generator = Generator(source)
    rules = generator.rule_base()
    compiled, experta = CompiledEngine(VOCABULARY), ExpertaEngine(VOCABULARY)
    fired = 0
    for _ in range(fact_sets):
        facts = generator.facts()
        expected = outcome(compiled, rules, facts)
        source.shuffle(facts)
        found = outcome(experta, rules, facts)
        assert repr_of(found) == repr_of(expected), f"{rules.model_dump_json(by_alias=True)}\n{facts}"
        assert plan(rules, found) == plan(rules, expected)
        fired += len(expected.firings) if isinstance(expected, Firings) else 0
    return fired


def repr_of(result: Firings | str) -> str:
    # By text, because True equals 1 and 1 equals 1.0.
    return result if isinstance(result, str) else f"{result.firings} {sorted(map(repr, result.facts))}"


def test_both_engines_return_the_same_firings_and_plans_for_random_programs() -> None:
    fired = sum(compare(random.Random(seed)) for seed in range(CASES))
    print(f"experta and compiled: {CASES} programs on 2 fact sets each, {fired} firings")
    assert fired > CASES, "the random programs hardly fire, so that they prove little"


@given(st.randoms(use_true_random=False))
def test_both_engines_return_the_same_firings_for_any_program(source: random.Random) -> None:
    compare(source, fact_sets=1)


def test_the_compiled_engine_follows_the_semantics_to_the_letter() -> None:
    fired = 0
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
        fired += len(firings)
    print(f"compiled and the literal reading: {CASES // 2} programs, {fired} firings")
    assert fired > CASES // 2


def test_clips_fires_the_same_rules_on_the_same_facts() -> None:
    compared, fired = 0, 0
    for seed in range(CASES):
        generator = Generator(random.Random(seed))
        rules, facts = generator.rule_base(), generator.facts()
        try:
            clips = ClipsEngine(VOCABULARY, rules, STAGE)  # a new one each time: clipspy keeps every fact it has seen
        except (CyclicNegation, Inexpressible):
            continue
        expected = {
            (firing.rule, firing.bindings) for firing in CompiledEngine(VOCABULARY).infer(rules, STAGE, facts).firings
        }
        assert clips.infer(facts) == expected, f"seed {seed}"
        compared, fired = compared + 1, fired + len(expected)
    print(f"compiled and CLIPS: {compared} programs, {fired} firings")
    assert compared > CASES // 2
    assert fired > compared


def test_rules_fire_among_those_that_they_build_on_as_among_all() -> None:
    engine, compared = CompiledEngine(VOCABULARY), 0
    for seed in range(CASES):
        generator = Generator(random.Random(seed))
        rules, facts = generator.rule_base(), generator.facts()
        whole = outcome(engine, rules, facts)
        if isinstance(whole, str):
            continue
        for wanted in rules.of_stage(STAGE):
            some = with_sources(rules.of_stage(STAGE), lambda rule, wanted=wanted: rule is wanted)
            part = engine.infer(rules.model_copy(update={"rules": list(some)}), STAGE, facts)
            expected = [firing for firing in whole.firings if firing.rule in {rule.id for rule in some}]
            assert repr(part.firings) == repr(tuple(expected))
            compared += len(some) < len(rules.of_stage(STAGE)) and bool(expected)
    assert compared > CASES, "hardly any part of a program fires, so that this proves little"
