"""Measure inference: `python -m benchmarks.inference`, or `make bench-inference`.

In one run, taken in turn: the shipped rules on recorded pairs, all stages as the loop asks for them, and generated
rule bases of 50, 200 and 1000 rules; by experta, by the compiled engine and, for the generated ones, by CLIPS. Building
is reported apart, because an engine builds once per rule base and stage and then serves any number of pairs. Times are
CPU times of this process, medians.

`--memory` instead infers 10 000 pairs with each engine and reports by how much the process grows.
"""

from __future__ import annotations

import argparse
import gc
import os
import random
import resource
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.clips_engine import ClipsEngine
from benchmarks.pairs import development_pairs, rendered_pair
from expert import ExpertSystem
from expert.engine import ENGINES, make_engine
from expert.facts import Fact, FieldInfo, TemplateInfo, Vocabulary
from expert.firing import Firings
from expert.rules.model import RuleBase, Stage

TEMPLATES = 20
FIELDS = 6
SIZES = (50, 200, 1000)
TARGETS_MS = {"experta": 12.0, "compiled": 1.5}  # shipped rules, all stages of one pair
MEMORY_PAIRS = 10_000


def generated_vocabulary() -> Vocabulary:
    """Return templates with numeric fields."""
    fields = {f"x{index}": FieldInfo(f"x{index}", "number", "1", "a number") for index in range(FIELDS)}
    names = [f"t{index}" for index in range(TEMPLATES)]
    return {name: TemplateInfo(name, "generated", fields, ()) for name in names}


def generated_rules(size: int, seed: int = 0) -> RuleBase:
    """Return rules of the usual shape: two comparisons, a negation, and for one in five a finding of an earlier one."""
    source = random.Random(seed)

    def comparison() -> dict[str, Any]:
        template, field = f"t{source.randrange(TEMPLATES)}", f"x{source.randrange(FIELDS)}"
        op = source.choice(("gt", "lt"))
        return {"fact": template, "as": template, "field": field, "op": op, "value": round(source.random(), 2)}

    rules = []
    for number in range(size):
        when: list[Any] = [comparison(), comparison(), {"not": comparison()}]
        if number > 10 and source.random() < 0.2:
            when.append({"finding": f"f{source.randrange(number // 10)}"})
        then: list[Any] = [{"derive": f"f{number // 10}"}] if number % 10 == 0 else []
        then.append({"choose": f"correction.op_{number % 7}", "with": {"strength": {"field": f"{when[0]['fact']}.x0"}}})
        rules.append(
            {
                "id": f"GEN{number:03d}", "name": "generated", "stage": "correction",
                "when": when, "then": then, "because": "generated for a measurement of time", "references": ["none"],
            }
        )  # fmt: skip
    return RuleBase.model_validate({"rules": rules})


def generated_facts(seed: int) -> list[Fact]:
    """Return one fact per template."""
    source = random.Random(seed)
    return [
        Fact.of(f"t{template}", **{f"x{field}": round(source.random(), 3) for field in range(FIELDS)})
        for template in range(TEMPLATES)
    ]


@dataclass(frozen=True)
class Call:
    """One inference that the loop asked for."""

    stage: Stage
    facts: tuple[Fact, ...]


class Recording:
    """An engine that notes what it is asked."""

    name = "recording"

    def __init__(self, system: ExpertSystem) -> None:
        self.calls: list[Call] = []
        self._engine = system._knowledge.engine

    def infer(self, rules: RuleBase, stage: Stage, facts: Iterable[Fact]) -> Firings:
        """Note the call and answer it."""
        given = tuple(facts)
        self.calls.append(Call(stage, given))
        return self._engine.infer(rules, stage, given)


def recorded_pairs() -> tuple[RuleBase, Vocabulary, dict[str, list[Call]]]:
    """Reconstruct some pairs and return what the loop asked the engine about each."""
    system = ExpertSystem(engine="compiled")
    scored = [rendered_pair()]
    if data := os.environ.get("TERREX_DATA"):
        scored += list(development_pairs(Path(data)))[:3]
    recording = Recording(system)
    system._knowledge = replace(system._knowledge, engine=recording)
    found = {}
    for item in scored:
        recording.calls = found[item.pair.name] = []
        system.reconstruct(item.pair)
    return system.rule_base, system._knowledge.words, found


def timed(work: Callable[..., Any], *arguments: Any) -> float:
    """Return the CPU time of some work in ms."""
    start = time.process_time()
    work(*arguments)
    return 1e3 * (time.process_time() - start)


def shipped(rounds: int) -> None:
    """Print the time of all inferences of one pair, shipped rules."""
    rules, words, pairs = recorded_pairs()
    print(f"shipped rules, {len(rules.rules)} of them; all inferences of one pair together, median of {rounds}")
    for name, calls in pairs.items():
        engines = {engine: make_engine(engine, words) for engine in ENGINES}
        first = {engine: timed(_all, made, rules, _renewed(calls)) for engine, made in engines.items()}
        times: dict[str, list[float]] = {engine: [] for engine in engines}
        gc.collect()
        for _ in range(rounds):
            for engine, made in engines.items():
                times[engine].append(timed(_all, made, rules, _renewed(calls)))
        for engine in engines:
            print(
                f"  {name:24} {engine:9} {len(calls)} inferences  first {first[engine]:8.2f} ms  "
                f"then {statistics.median(times[engine]):7.3f} ms  (target {TARGETS_MS[engine]:g})"
            )


def _renewed(calls: list[Call]) -> list[Call]:
    """Return the calls with new facts, as a new pair brings them: nothing computed for another pair helps."""
    known = {fact: Fact(fact.template, fact.fields) for call in calls for fact in call.facts}
    return [Call(call.stage, tuple(known[fact] for fact in call.facts)) for call in calls]


def _all(engine: Any, rules: RuleBase, calls: list[Call]) -> None:
    for call in calls:
        engine.infer(rules, call.stage, call.facts)


def generated(rounds: int) -> None:
    """Print the time of one inference over generated rules, three engines in turn."""
    words = generated_vocabulary()
    for size in SIZES:
        rules = generated_rules(size)
        engines: dict[str, Any] = {name: make_engine(name, words) for name in ENGINES}
        first = {name: timed(made.infer, rules, "correction", generated_facts(0)) for name, made in engines.items()}
        start = time.process_time()
        clips = ClipsEngine(words, rules, "correction")
        clips.infer(generated_facts(0))
        first["clips"] = 1e3 * (time.process_time() - start)
        times: dict[str, list[float]] = {name: [] for name in first}
        fired = 0
        gc.collect()
        for seed in range(rounds):
            facts = generated_facts(seed)
            for name, made in engines.items():
                fresh = [Fact(fact.template, fact.fields) for fact in facts]
                times[name].append(timed(made.infer, rules, "correction", fresh))
            times["clips"].append(timed(clips.infer, facts))
            fired = len(engines["compiled"].infer(rules, "correction", facts).firings)
        with _silent():  # of facts that clipspy never frees, CLIPS complains when it ends
            del clips
        print(f"generated, {size} rules, {fired} firings, median of {rounds}")
        for name in times:
            print(f"  {name:9} first {first[name]:8.2f} ms  then {statistics.median(times[name]):7.3f} ms")


@contextmanager
def _silent() -> Iterator[None]:
    """Send what libraries print past Python to nowhere."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def memory(pairs: int) -> None:
    """Print by how much the process grows over many pairs, each with facts of its own."""
    rules, words, recorded = recorded_pairs()
    calls = next(iter(recorded.values()))
    for name in ENGINES:
        engine = make_engine(name, words)
        for seed in range(200):  # until caches and pools have their size
            _infer_varied(engine, rules, calls, seed)
        gc.collect()
        before, blocks = _resident_kb(), len(gc.get_objects())
        for seed in range(pairs):
            _infer_varied(engine, rules, calls, seed)
        gc.collect()
        print(
            f"{name:9} {pairs} pairs: {_resident_kb() - before:+d} kB resident, "
            f"{len(gc.get_objects()) - blocks:+d} objects"
        )


def _infer_varied(engine: Any, rules: RuleBase, calls: list[Call], seed: int) -> None:
    """Infer the calls of a pair with every number changed a little, so that no two pairs are alike."""
    source = random.Random(seed)
    factor = 1.0 + 0.2 * source.random()
    for call in calls:
        varied = [Fact(fact.template, tuple(_scaled(fact, factor))) for fact in call.facts]
        engine.infer(rules, call.stage, varied)


def _scaled(fact: Fact, factor: float) -> Iterable[tuple[str, Any]]:
    for name, value in fact.fields:
        yield name, round(value * factor, 4) if isinstance(value, float) else value


def _resident_kb() -> int:
    status = Path("/proc/self/status")
    if status.is_file():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmRSS"))
        return int(line.split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    """Print tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=30, help="repetitions, engines taken in turn")
    parser.add_argument("--memory", action="store_true", help=f"growth over {MEMORY_PAIRS} pairs instead of times")
    parser.add_argument("--pairs", type=int, default=MEMORY_PAIRS, help="pairs for --memory")
    options = parser.parse_args()
    if options.memory:
        memory(options.pairs)
    else:
        generated(options.rounds)
        shipped(options.rounds)


if __name__ == "__main__":
    main()
