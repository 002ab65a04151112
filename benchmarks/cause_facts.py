"""Print what chosen facts read of every simulated cause: the numbers that rules about causes name.

    TERREX_DATA=... python -m benchmarks.cause_facts FACT.FIELD [FACT.FIELD ...] [--every N] [--seeds 2]
                                            [--only CAUSE ...]

`benchmarks.causes` says how often a cause is named; this says on what it rests. The causes and their strengths are the
same, all in the right image. For each cause and strength: the number of pairs, the least value, the
10 % point, the median, the 90 % point and the largest. A probe that cannot measure a pair gives no value.
"""

from __future__ import annotations

import argparse
import itertools
import os
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.causes import CAUSES, STRENGTHS, applies, damaged, subjects
from modules.catalog import probes
from modules.measurement.sample import Sample
from modules.operator import OperatorError
from modules.types import Views

PERCENTILES = (0, 10, 50, 90, 100)
HEADINGS = ("least", "10 %", "median", "90 %", "largest")
Field = tuple[str, str]  # fact and field


def field(text: str) -> Field:
    """Read FACT.FIELD, of a fact about a pair."""
    fact, _, name = text.partition(".")
    known = {
        model.template: model.model_fields
        for probe in probes().values()
        if probe.subject == "pair"
        for model in probe.templates
    }
    if name not in known.get(fact, {}):
        raise argparse.ArgumentTypeError(f"{text} is no field of a fact about a pair; `terrex rules pages` lists them")
    return fact, name


def readings(views: Views, fields: Sequence[Field]) -> Iterator[tuple[Field, float]]:
    """Yield the values of the fields; only the probes that measure them run."""
    sample, wanted = Sample(views), {fact for fact, _ in fields}
    for probe in probes().values():
        if probe.subject != "pair" or not wanted & {model.template for model in probe.templates}:
            continue
        try:
            models = probe.function(sample)
        except OperatorError:
            continue
        for model in models:
            for fact, name in fields:
                value = getattr(model, name) if model.template == fact else None
                if value is not None:
                    yield (fact, name), float(value)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("fields", nargs="+", type=field, metavar="FACT.FIELD")
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--every", type=int, default=1, help="take every N-th pair only")
    parser.add_argument("--seeds", type=int, default=2, help="damages of each cause and strength per pair")
    parser.add_argument("--only", nargs="*", default=[], metavar="CAUSE", help="causes to simulate; all by default")
    args = parser.parse_args()
    if not args.data:
        parser.error("no data: set TERREX_DATA or give --data FOLDER")
    if unknown := set(args.only) - set(CAUSES):
        parser.error(f"no causes: {', '.join(sorted(unknown))}; known are {', '.join(CAUSES)}")
    values: dict[tuple[Field, str], list[float]] = defaultdict(list)
    causes = [name for name in CAUSES if not args.only or name in args.only]
    for subject in subjects(Path(args.data), args.every, 0, 0):
        for place, value in readings(subject.views, args.fields):
            values[place, "clean"].append(value)
        for name in causes:
            for strength, number in itertools.product(STRENGTHS, range(args.seeds)):
                if not applies(name, subject.views):
                    continue
                seed = subject.first_seed + 2 * number  # even: the right image
                views = damaged(subject.views, [CAUSES[name].damage], strength, seed)
                for place, value in readings(views, args.fields):
                    values[place, f"{name} x{strength:g}"].append(value)
    for place in args.fields:
        print(f"\n{'.'.join(place):28s}{'count':>6s}" + "".join(f"{heading:>10s}" for heading in HEADINGS))
        for kind in ("clean", *(f"{name} x{strength:g}" for name in causes for strength in STRENGTHS)):
            if known := values.get((place, kind)):
                points = np.percentile(known, PERCENTILES)
                print(f"  {kind:26s}{len(known):6d}" + "".join(f"{point:10.3f}" for point in points))


if __name__ == "__main__":
    main()
