"""The same facts give the same bytes: on every run, for every hash seed, with both engines, and on every Python."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
from determinism import RECORDS, canonical, digest_of_programs
from random_programs import STAGE, Generator, small_vocabulary

from expert.decision import Decision, FiringRecord
from expert.engine import ENGINES, EngineName, make_engine
from expert.explain import rules_of
from expert.facts import vocabulary
from expert.redecide import redecided
from modules.catalog import probes

RUNS = 200
# Of `digest_of_programs`; it changes with the language and with the random programs, and never with the Python.
DIGEST = "896c4d882142121680b8ced85ff176ad1994b74f0e616f7e047080e2d1e21965"
RECORDED = sorted(RECORDS.glob("*.json"))


@pytest.mark.parametrize("engine", ENGINES)
def test_random_programs_give_the_bytes_that_are_written_down(engine: EngineName) -> None:
    assert digest_of_programs(engine) == DIGEST


@pytest.mark.parametrize("engine", ENGINES)
def test_the_order_of_facts_changes_no_byte_in_200_runs(engine: EngineName) -> None:
    generator = Generator(random.Random(3))
    rules, facts = generator.rule_base(), [fact for _ in range(3) for fact in generator.facts()]
    made = make_engine(engine, small_vocabulary())
    first = canonical(made.infer(rules, STAGE, facts))
    assert first[0]
    for repeat in range(RUNS):
        random.Random(repeat).shuffle(facts)
        assert canonical(made.infer(rules, STAGE, facts)) == first


def concluded(firings: tuple[FiringRecord, ...]) -> list[object]:
    """Return what fired on what and concluded what, without words that may be written better one day."""
    return [
        (
            firing.rule,
            firing.stage,
            {alias: (record.template, record.fields) for alias, record in firing.bindings.items()},
            [(action.kind, action.values) for action in firing.actions],
        )
        for firing in firings
    ]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("path", RECORDED, ids=lambda path: path.stem)
def test_recorded_facts_fire_what_was_recorded(path: Path, engine: EngineName) -> None:
    decision = Decision.from_json(path.read_text(encoding="utf-8"))
    again = redecided(decision, rules_of(decision), make_engine(engine, vocabulary(probes().values())))
    assert concluded(again.firings) == concluded(decision.firings)
    assert [(item.name, item.severity) for item in again.findings] == [
        (item.name, item.severity) for item in decision.findings
    ]
    for stage, plan in decision.plans.items():
        assert [(step.operator, step.chosen_by) for step in again.plans[stage].steps] == [
            (step.operator, step.chosen_by) for step in plan.steps
        ]


def test_recorded_facts_give_the_same_core_in_200_runs() -> None:
    decision = Decision.from_json(RECORDED[0].read_text(encoding="utf-8"))
    rules, engine = rules_of(decision), make_engine("compiled", vocabulary(probes().values()))
    facts = list(decision.facts)
    cores = set()
    for repeat in range(RUNS):
        random.Random(repeat).shuffle(facts)
        again = redecided(decision.model_copy(update={"facts": tuple(facts)}), rules, engine)
        cores.add(again.model_copy(update={"facts": decision.facts}).core())
    assert len(cores) == 1


def test_hash_seeds_change_no_byte() -> None:
    script = Path(__file__).with_name("determinism.py")
    printed = {
        subprocess.run(
            [sys.executable, str(script), *map(str, RECORDED)],
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(Path(__file__).parents[3])},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("0", "1", "4242")
    }
    assert len(printed) == 1
    assert DIGEST in printed.pop()
