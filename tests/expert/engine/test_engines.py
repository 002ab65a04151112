"""What every engine promises: determinism, named errors, no trace of an earlier call."""

from __future__ import annotations

import random
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from random_programs import STAGE, Generator, small_vocabulary

from expert.engine import ENGINES, make_engine
from expert.engine.cache import ProgramCache
from expert.engine.compiled import CompiledEngine
from expert.engine.experta_engine import ExpertaEngine
from expert.facts import Fact
from expert.firing import Engine, Firings, RunawayRuleBase
from expert.rules.model import RuleBase
from expert.rules.strata import CyclicNegation

VOCABULARY = small_vocabulary()
ENGINE_CLASSES: dict[str, Callable[..., Engine]] = {"experta": ExpertaEngine, "compiled": CompiledEngine}


def rule(name: str, when: list[Any], then: list[Any] | None = None, stage: str = STAGE) -> dict[str, Any]:
    return {
        "id": name, "name": "test", "stage": stage, "when": when, "then": then or [{"derive": "seen"}],
        "because": "because of a test", "references": ["test"],
    }  # fmt: skip


def base(*rules: dict[str, Any]) -> RuleBase:
    return RuleBase.model_validate({"rules": list(rules)})


def fired(result: Firings) -> list[str]:
    return [firing.rule for firing in result.firings]


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> Engine:
    return make_engine(request.param, VOCABULARY)


def test_the_same_program_gives_the_same_firings_fifty_times(engine: Engine) -> None:
    generator = Generator(random.Random(3))
    rules, facts = generator.rule_base(), [fact for _ in range(3) for fact in generator.facts()]
    first = engine.infer(rules, STAGE, facts)
    assert first.firings
    for repeat in range(50):
        random.Random(repeat).shuffle(facts)
        assert repr(engine.infer(rules, STAGE, facts).firings) == repr(first.firings)


def test_a_chain_of_findings_is_followed_to_its_end(engine: Engine) -> None:
    links = [rule(f"LNK{n:03d}", [{"finding": f"f{n - 1}"}], [{"derive": f"f{n}"}]) for n in range(8, 0, -1)]
    result = engine.infer(base(rule("AAA001", [{"fact": "a"}], [{"assess": "f0"}]), *links), STAGE, [Fact.of("a")])
    assert len(result.firings) == 9
    assert Fact.of("finding", name="f8", severity="minor") in result.facts


def test_a_negated_finding_waits_for_every_rule_that_may_derive_it(engine: Engine) -> None:
    rules = base(
        rule("AAA001", [{"fact": "a"}, {"not": {"finding": "late"}}], [{"derive": "quiet"}]),
        rule("BBB001", [{"finding": "early"}], [{"derive": "late"}]),
        rule("CCC001", [{"fact": "a"}], [{"derive": "early"}]),
    )
    assert fired(engine.infer(rules, STAGE, [Fact.of("a")])) == ["BBB001", "CCC001"]


def test_a_finding_of_a_lower_severity_does_not_match(engine: Engine) -> None:
    rules = base(rule("AAA001", [{"finding": "given", "at_least": "major"}]))
    for severity, expected in (("minor", []), ("major", ["AAA001"]), ("critical", ["AAA001"])):
        facts = [Fact.of("finding", name="given", severity=severity)]
        assert fired(engine.infer(rules, STAGE, facts)) == expected


def test_a_rule_fires_once_for_every_pair_of_facts_that_joins(engine: Engine) -> None:
    when = [{"fact": "a", "as": "p"}, {"fact": "a", "as": "q", "field": "x", "op": "gt", "value": {"field": "p.x"}}]
    result = engine.infer(base(rule("AAA001", when)), STAGE, [Fact.of("a", x=x) for x in (1, 2, 2, 3)])
    pairs = [tuple(fact.get("x") for _, fact in firing.bindings) for firing in result.firings]
    assert pairs == [(1, 2), (1, 3), (2, 3)]


def test_for_all_holds_when_no_fact_is_asked_for(engine: Engine) -> None:
    body = {"where": [{"fact": "b"}], "then": [{"fact": "b", "field": "x", "op": "gt", "value": {"field": "a.x"}}]}
    rules = base(rule("AAA001", [{"fact": "a"}, {"for_all": body}]))
    assert fired(engine.infer(rules, STAGE, [Fact.of("a", x=1)])) == ["AAA001"]
    assert fired(engine.infer(rules, STAGE, [Fact.of("a", x=1), Fact.of("b", x=2)])) == ["AAA001"]
    assert fired(engine.infer(rules, STAGE, [Fact.of("a", x=1), Fact.of("b", x=2), Fact.of("b", x=0)])) == []


def test_an_action_whose_operand_is_missing_is_left_out_and_the_rest_stays(engine: Engine) -> None:
    then = [{"choose": "correction.op", "with": {"k": {"field": "a.y"}}}, {"derive": "seen"}]
    result = engine.infer(base(rule("AAA001", [{"fact": "a"}], then)), STAGE, [Fact.of("a", x=1)])
    assert [(action.index, action.kind) for action in result.firings[0].actions] == [(1, "derive")]


def test_only_the_rules_of_the_stage_fire(engine: Engine) -> None:
    rules = base(rule("AAA001", [{"fact": "a"}]), rule("BBB001", [{"fact": "a"}], stage="matching"))
    assert fired(engine.infer(rules, "matching", [Fact.of("a")])) == ["BBB001"]
    assert engine.infer(rules, "reconstruction", [Fact.of("a")]) == Firings((), frozenset([Fact.of("a")]))


def test_a_cycle_through_negation_names_its_rules(engine: Engine) -> None:
    rules = base(
        rule("AAA001", [{"fact": "a"}, {"not": {"finding": "two"}}], [{"derive": "one"}]),
        rule("BBB001", [{"finding": "one"}], [{"derive": "two"}]),
        rule("CCC001", [{"finding": "two"}], [{"derive": "three"}]),
    )
    with pytest.raises(
        CyclicNegation, match="rules AAA001 -> BBB001 -> AAA001 depend on each other's findings"
    ) as error:
        engine.infer(rules, STAGE, [Fact.of("a")])
    assert error.value.rules == ("AAA001", "BBB001")


@pytest.mark.parametrize("name", ENGINES)
def test_a_runaway_rule_base_is_ended_and_leaves_nothing_behind(name: str) -> None:
    engine = ENGINE_CLASSES[name](VOCABULARY, max_firings=10)
    when = [{"fact": "a", "as": "p"}, {"fact": "a", "as": "q"}]
    rules = base(rule("AAA001", [{"fact": "a"}]), rule("BBB001", when))
    expected = "ended after 10 firings, the most allowed; rule BBB001 fired most"
    with pytest.raises(RunawayRuleBase, match=expected):
        engine.infer(rules, STAGE, [Fact.of("a", n=n) for n in range(3)] + [Fact.of("a", n=n) for n in range(3, 5)])
    result = engine.infer(rules, STAGE, [Fact.of("a", n=9)])
    assert fired(result) == ["AAA001", "BBB001"]
    assert result.facts == {Fact.of("a", n=9), Fact.of("finding", name="seen", severity="minor")}


def test_an_exception_in_one_call_leaks_no_facts_into_the_next(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    rules = base(rule("AAA001", [{"fact": "a"}]), rule("BBB001", [{"fact": "a"}, {"fact": "b"}]))
    with monkeypatch.context() as patch:
        patch.setattr("expert.engine.common.Record.add", _fail)
        with pytest.raises(ZeroDivisionError):
            engine.infer(rules, STAGE, [Fact.of("a", n=1), Fact.of("b", n=1)])
    result = engine.infer(rules, STAGE, [Fact.of("a", n=2)])
    assert fired(result) == ["AAA001"]
    assert Fact.of("b", n=1) not in result.facts


def _fail(*_: object) -> None:
    raise ZeroDivisionError


def test_facts_that_cannot_be_read_leave_the_engine_usable(engine: Engine) -> None:
    def broken() -> Iterator[Fact]:
        yield Fact.of("a", n=1)
        raise OSError("the camera is gone")

    rules = base(rule("AAA001", [{"fact": "a"}]))
    with pytest.raises(OSError, match="the camera is gone"):
        engine.infer(rules, STAGE, broken())
    assert fired(engine.infer(rules, STAGE, [])) == []


def test_several_threads_may_share_an_engine(engine: Engine) -> None:
    rules = base(rule("AAA001", [{"fact": "a", "field": "n", "op": "ge", "value": 5}]))
    found: dict[int, list[str]] = {}

    def work(n: int) -> None:
        found[n] = fired(engine.infer(rules, STAGE, [Fact.of("a", n=n)]))

    threads = [threading.Thread(target=work, args=(n,)) for n in range(10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {n: ["AAA001"] if n >= 5 else [] for n in range(10)}


def test_an_unknown_engine_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match="unknown engine 'clips'; choose one of experta, compiled"):
        make_engine("clips", VOCABULARY)  # type: ignore[arg-type]


def test_importing_the_engine_changes_neither_logging_nor_the_standard_library() -> None:
    script = (
        "import collections, logging, sys; from expert.engine import make_engine; assert 'experta' not in sys.modules;"
        "make_engine('compiled', {}); assert 'experta' not in sys.modules; make_engine('experta', {});"
        "assert logging.root.handlers == [] and not hasattr(collections, 'Mapping')"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_the_cache_forgets_the_entry_that_was_not_used_longest() -> None:
    cache: ProgramCache[int] = ProgramCache(capacity=2)
    bases = [RuleBase(), RuleBase(), RuleBase()]
    built = [cache.get(bases[index], STAGE, lambda index=index: index) for index in (0, 1)]
    assert built == [0, 1]
    assert cache.get(bases[0], STAGE, lambda: 10) == 0
    assert cache.get(bases[2], STAGE, lambda: 2) == 2
    assert cache.get(bases[1], STAGE, lambda: 11) == 11
