"""Measure the time of one inference: `python -m benchmarks.inference`.

The shipped rules, stage by stage, and generated rule bases of 50, 200 and 1000 rules, with both engines. Building is
timed apart, because an engine builds once per rule base and stage and then serves any number of pairs. Times are CPU
times of this process, the median over the pairs.
"""

from __future__ import annotations

import argparse
import gc
import random
import time
from typing import Any

from expert.engine import ENGINES, make_engine
from expert.facts import Fact, FieldInfo, TemplateInfo, Vocabulary, vocabulary
from expert.rules.model import STAGES, RuleBase, Stage

TEMPLATES = 20
FIELDS = 6
SIZES = (50, 200, 1000)


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


def measure(rules: RuleBase, stage: Stage, vocabulary: Vocabulary, facts: list[list[Fact]]) -> list[str]:
    """Return one line per engine: firings, time to build and to infer the first time, median time of the others."""
    lines = []
    for name in ENGINES:
        engine = make_engine(name, vocabulary)
        gc.collect()  # what the engine before has left is not this one's to clear
        start = time.process_time()
        fired = len(engine.infer(rules, stage, facts[0]).firings)
        first = time.process_time() - start
        times = []
        for each in facts:
            start = time.process_time()
            engine.infer(rules, stage, each)
            times.append(time.process_time() - start)
        median = sorted(times)[len(times) // 2]
        lines.append(f"{name:10}{fired:8d} firings  first {1e3 * first:9.2f} ms  then {1e3 * median:9.3f} ms")
    return lines


def shipped() -> tuple[RuleBase, Vocabulary] | None:
    """Return the shipped rules, if they can be loaded."""
    try:
        from expert.rules.load import load_rules
        from modules.catalog import operators, probes
    except ImportError:
        return None
    words = vocabulary(probes().values())
    return load_rules(None, words, operators(), probes()).base, words


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=10, help="number of fact sets to infer from")
    options = parser.parse_args()
    facts = [generated_facts(seed) for seed in range(options.pairs)]
    for size in SIZES:
        print(f"generated, {size} rules")
        print("\n".join(measure(generated_rules(size), "correction", generated_vocabulary(), facts)))
    found = shipped()
    if found is None:
        print("shipped rules: none can be loaded")
        return
    rules, words = found
    for stage in STAGES:
        print(f"shipped, {stage}, {len(rules.of_stage(stage))} rules")
        print("\n".join(measure(rules, stage, words, [plausible_facts(words, seed) for seed in range(options.pairs)])))


def plausible_facts(words: Vocabulary, seed: int) -> list[Fact]:
    """Return one fact per template, every field within its range."""
    source = random.Random(seed)

    def value(info: FieldInfo) -> Any:
        if info.kind == "boolean":
            return source.random() < 0.5
        if info.kind == "text":
            return source.choice(info.choices or ("none",))
        low, high = info.ge if info.ge is not None else -100.0, info.le if info.le is not None else 100.0
        number = source.uniform(low, max(low, high))
        return int(number) if info.kind == "integer" else number

    templates = sorted(words.values(), key=lambda info: info.name)
    return [
        Fact.of(info.name, **{name: value(field) for name, field in info.fields.items()})
        for info in templates
        if info.name != "finding"
    ]


if __name__ == "__main__":
    main()
