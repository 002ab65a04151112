"""Measure the time to check a large rule file: `python -m benchmarks.rule_check [RULES ...]`.

The files are generated over the real vocabulary: findings derived from two comparisons, choices and parameters that ask
for them, formulas with units. Reading, merging and all checks are timed together, in CPU seconds of this process, the
best of three; the time of reading the YAML alone stands beside it.
"""

from __future__ import annotations

import random
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from expert.facts import FieldInfo, vocabulary
from expert.rules.check import check_rules
from expert.rules.reader import read_document
from modules.catalog import operators, probes

SIZES = (100, 1000)
REPEATS = 3


def _limit(source: random.Random, info: FieldInfo) -> float:
    low, high = (0.0 if info.ge is None else info.ge), (100.0 if info.le is None else info.le)
    return round(low + (high - low) * (0.2 + 0.6 * source.random()), 3)


def generated(size: int, seed: int = 0) -> str:
    """Return a rule file of that many rules."""
    source = random.Random(seed)
    words = vocabulary(probes().values())
    cheap = [name for name, probe in probes().items() if probe.subject == "pair" and probe.tier == "cheap"]
    fields = [
        (template.name, field)
        for template in words.values()
        if template.probe in cheap
        for field in template.fields.values()
        if field.kind == "number"
    ]
    choices = [operator for operator in operators().values() if operator.stage == "correction"]
    findings = [f"finding-{number}" for number in range(size // 3 + 1)]
    lines = ["version: 1", "findings:", *(f"  {name}: generated" for name in findings)]
    slots = sorted({operator.slot for operator in choices})
    lines += ["slots:", "  correction:", *(f"    - {{slot: {name}, default: none, because: none}}" for name in slots)]
    lines.append("rules:")
    for number in range(size):
        (one, first), (two, second) = source.sample(fields, 2)
        name = findings[number // 3]
        formula = f"{{max: [{{mul: [2, {{field: b.{second.name}}}]}}, 1]}}"
        conditions = [
            f"{{fact: {one}, as: a, field: {first.name}, op: gt, value: {_limit(source, first)}}}",
            f"{{fact: {two}, as: b, field: {second.name}, op: le, value: {formula}}}",
        ]
        stage, action = "measurement", f"{{derive: {name}}}"
        if number % 3:
            operator = source.choice(choices)
            stage, action = "correction", f"{{choose: {operator.name}, score: {source.random():.6f}}}"
            conditions.append(f"{{finding: {name}}}")
        lines += [
            f"  - id: {('MEA', 'COR')[stage == 'correction']}{number:03d}",
            f"    name: generated-{number}",
            f"    stage: {stage}",
            "    when:",
            *(f"      - {text}" for text in conditions),
            "    then:",
            f"      - {action}",
            "    because: generated for a measurement of time",
            "    references: [none]",
        ]
    return "\n".join(lines) + "\n"


def _best(work: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def main() -> None:
    """Print a table."""
    known = (vocabulary(probes().values()), operators(), probes())
    sizes = [int(text) for text in sys.argv[1:]] or SIZES
    print(f"{'rules':>6} {'lines':>7} {'read s':>8} {'check s':>8} {'problems':>9}")
    with tempfile.TemporaryDirectory() as folder:
        for size in sizes:
            path = Path(folder) / f"{size}.yaml"
            text = generated(size)
            path.write_text(text, encoding="utf-8")
            reading = _best(lambda path=path: read_document(str(path), path.read_bytes()))
            found = check_rules([path], *known, shipped=False, with_cases=False)
            checking = _best(lambda path=path: check_rules([path], *known, shipped=False, with_cases=False))
            lines = text.count("\n")
            print(f"{size:6d} {lines:7d} {reading:8.3f} {checking:8.3f} {len(found):9d}")


if __name__ == "__main__":
    main()
