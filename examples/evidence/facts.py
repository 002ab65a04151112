"""Print what each fact that a rule compares with a limit reads on known differences between the two images.

The evidence behind the thresholds of knowledge/rules.yaml: for every compared fact field, and every reference
distortion of the right image, the least, the 10 % point, the median, the 90 % point and the largest value over the
development pairs. A threshold is sound where the values of undistorted pairs lie on one side and those of the
distortion that it shall find on the other.

    python examples/evidence/facts.py --data FOLDER             all facts about pairs, some minutes
    python examples/evidence/facts.py --data FOLDER --limit 2   the first two pairs of each kind only
    python examples/evidence/facts.py --data FOLDER --products  facts about disparities too: runs the whole system

The folder holds an INDEX.json, a list of pairs, with at least: `left`, `right` (paths inside the folder), `split`
(`dev` or `terrain`), `radiometric_difference` (whether the cameras saw different light or exposure), and
`gt_disp_range` (the true range, or null).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from expert import ExpertSystem, StereoPair
from expert.facts import Fact, to_fact, vocabulary
from expert.rules.checks.context import walk
from expert.rules.evaluate import resolve
from expert.rules.load import LoadedRules, load_rules
from expert.rules.model import Comparison, Rule
from modules.catalog import operators, probes
from modules.formats.images import read_image
from modules.measurement.sample import Sample
from modules.operator import OperatorError
from modules.probe import Probe
from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right
from modules.types import Views

NUMERIC = (
    "lt", "le", "gt", "ge", "abs_lt", "abs_le", "abs_gt", "abs_ge", "between", "significantly_gt", "significantly_lt"
)  # fmt: skip
PERCENTILES = (0, 10, 50, 90, 100)
HEADINGS = ("least", "10 %", "median", "90 %", "largest")
AS_RECORDED = "as recorded"  # undistorted pairs that differ already: other light or exposure
TERRAIN = "terrain"  # undistorted pairs of natural terrain

Entry = Mapping[str, Any]  # one pair of the index
Facts = Mapping[str, Sequence[Fact]]  # by template
Reading = Callable[[Facts, Entry], list[float]]


@dataclass(frozen=True)
class Quantity:
    """One number that is read of every pair.

    Attributes
    ----------
    name : str
    template : str
        Of the facts it is read from.
    read : callable
        From the facts of a pair by template, and its entry of the index, to its values.
    limits : list of str
        What rules compare it with.
    """

    name: str
    template: str
    read: Reading
    limits: list[str] = field(default_factory=list)


def field_reading(template: str, name: str, keys: tuple[tuple[str, object], ...]) -> Reading:
    """Return a reading of one field of the facts whose key fields have the given values."""

    def read(facts: Facts, _: Entry) -> list[float]:
        wanted = (fact for fact in facts.get(template, ()) if all(fact.get(key) == value for key, value in keys))
        return [float(value) for fact in wanted if (value := fact.get(name)) is not None]

    return read


def curve_gain(facts: Facts, _: Entry) -> list[float]:
    """Return by how much a curve explains the brightness better than gain and offset do, dn."""
    found = []
    for fact in facts.get("brightness", ()):
        line, curve = fact.get("residual_after_gain_offset_dn"), fact.get("residual_after_monotone_map_dn")
        if line is not None and curve is not None:
            found.append(float(line) - float(curve))
    return found


def range_ratio(facts: Facts, entry: Entry) -> list[float]:
    """Return the largest estimated disparity over the largest true one."""
    truth = entry.get("gt_disp_range")
    maxima = [fact.get("max_px") for fact in facts.get("disparity_range", ())]
    return [float(value) / truth[1] for value in maxima if value is not None] if truth else []


def limit_text(rule: Rule, condition: Comparison, loaded: LoadedRules) -> str:
    """Say which rule compares with what."""
    values = condition.value if isinstance(condition.value, list) else [condition.value]
    numbers = [resolve(value, {}, loaded.base.thresholds) for value in values]
    words = ["another fact" if number is None else f"{number:.4g}" for number in numbers]
    return f"{rule.id} {condition.op} {' and '.join(words)}"


def compared_quantities(loaded: LoadedRules, templates: Mapping[str, Probe]) -> list[Quantity]:
    """Return every field that a shipped rule compares with a limit, by template and name.

    A rule that compares a key (`channel` is `gray`) means only the facts with that key.
    """
    words = vocabulary(probes().values())
    found: dict[tuple[str, str, tuple[tuple[str, object], ...]], Quantity] = {}
    for rule in loaded.base.rules:
        comparisons = [item for item, _, _ in walk(rule) if isinstance(item, Comparison)]
        for item in comparisons:
            if item.fact not in templates or item.field is None or item.op not in NUMERIC:
                continue
            same = [other for other in comparisons if other.name == item.name and other.op == "eq"]
            keys = tuple((other.field, other.value) for other in same if other.field in words[item.fact].keys)
            place = (item.fact, item.field, keys)
            if place not in found:
                name = f"{item.fact}.{item.field}" + "".join(f", {key} {value}" for key, value in keys)
                found[place] = Quantity(name, item.fact, field_reading(*place))
            found[place].limits.append(limit_text(rule, item, loaded))
    return [found[place] for place in sorted(found, key=str)]


def derived_quantities() -> list[Quantity]:
    """Return the numbers that the reasons of rules name, but no single field holds."""
    return [
        Quantity("residual of gain and offset minus that of a curve", "brightness", curve_gain, ["MEA012 ge 1"]),
        Quantity("estimated over true largest disparity", "disparity_range", range_ratio, ["MAT002 widens by its own"]),
    ]


def measure_pair(views: Views, wanted: Sequence[Probe]) -> Iterator[Fact]:
    """Yield the facts about a pair as rules see them; a probe that cannot measure gives none."""
    sample = Sample(views)
    for probe in wanted:
        try:
            models = probe.function(sample)
        except OperatorError as error:
            print(f"{probe.name}: {error}", file=sys.stderr)
            continue
        yield from (to_fact(model) for model in models)


def measure_product(system: ExpertSystem, views: Views) -> Iterator[Fact]:
    """Yield the facts about the disparity that the system keeps for a pair."""
    for trial in system.reconstruct(StereoPair(views.left, views.right)).decision.trials:
        if trial.kept and trial.stage == "matching":
            yield from (Fact.of(record.template, **record.fields) for record in trial.product_facts)


def kinds_of(entry: Entry) -> Iterator[tuple[str, str]]:
    """Yield the names of the groups a pair is counted in, each with the distortion to apply."""
    if entry["split"] == "dev" and not entry["radiometric_difference"]:
        yield from ((name, name) for name in REFERENCE_DISTORTIONS)
    else:
        yield (TERRAIN if entry["split"] == "terrain" else AS_RECORDED), "clean"


def collect(
    folder: Path, entries: Sequence[Entry], quantities: Sequence[Quantity], seed: int, products: bool
) -> dict[tuple[str, str], list[float]]:
    """Return the values of every quantity over all pairs, by name and kind of difference."""
    needed = {quantity.template for quantity in quantities}
    wanted = [
        probe
        for probe in probes().values()
        if probe.subject == "pair" and needed & {model.template for model in probe.templates}
    ]
    system = ExpertSystem(engine="compiled") if products else None
    values: dict[tuple[str, str], list[float]] = defaultdict(list)
    for number, entry in enumerate(entries, start=1):
        print(f"{number} of {len(entries)}: {entry['left']}", file=sys.stderr)
        pair = Views(read_image(folder / entry["left"]), read_image(folder / entry["right"]))
        for kind, distortion in kinds_of(entry):
            views = distort_right(pair, distortion, seed=seed)
            facts: dict[str, list[Fact]] = defaultdict(list)
            for fact in measure_pair(views, wanted):
                facts[fact.template].append(fact)
            for fact in measure_product(system, views) if system else ():
                facts[fact.template].append(fact)
            for quantity in quantities:
                values[quantity.name, kind] += quantity.read(facts, entry)
    return values


def table(quantity: Quantity, values: Mapping[tuple[str, str], Sequence[float]]) -> str:
    """Return the lines that show one quantity."""
    lines = [f"{quantity.name}  ({'; '.join(quantity.limits)})"]
    lines.append(f"  {'':<14}{'count':>6}" + "".join(f"{heading:>10}" for heading in HEADINGS))
    for kind in (*REFERENCE_DISTORTIONS, AS_RECORDED, TERRAIN):
        known = values.get((quantity.name, kind), [])
        if known:
            points = np.percentile(known, PERCENTILES)
            lines.append(f"  {kind:<14}{len(known):>6}" + "".join(f"{point:>10.3f}" for point in points))
    if len(lines) == 2:
        lines.append("  not measured on any of these pairs")
    return "\n".join(lines)


def first_of_each(entries: Sequence[Entry], limit: int | None) -> list[Entry]:
    """Return the first few entries of each group, or all."""
    kept: list[Entry] = []
    counts: dict[tuple[str, ...], int] = defaultdict(int)
    for entry in entries:
        group = tuple(kind for kind, _ in kinds_of(entry))
        counts[group] += 1
        if limit is None or counts[group] <= limit:
            kept.append(entry)
    return kept


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    default = os.environ.get("TERREX_DATA")
    parser.add_argument("--data", type=Path, default=default, metavar="FOLDER", help="pairs; by default $TERREX_DATA")
    parser.add_argument("--limit", type=int, metavar="N", help="take only the first N pairs of each group")
    parser.add_argument("--seed", type=int, default=7, help="seed of the noise")
    parser.add_argument("--products", action="store_true", help="also reconstruct, and show facts about disparities")
    given = parser.parse_args()
    if given.data is None:
        parser.error("name the folder of the pairs with --data, or set TERREX_DATA")
    if not (given.data / "INDEX.json").is_file():
        parser.error(f"there is no INDEX.json in {given.data}")
    if given.limit is not None and given.limit < 1:
        parser.error(f"--limit is {given.limit}; give 1 or more")
    return given


def main() -> None:
    given = arguments()
    words = vocabulary(probes().values())
    loaded = load_rules(None, words, operators(), probes())
    subjects = ("pair", "disparity") if given.products else ("pair",)
    templates = {
        model.template: probe for probe in probes().values() if probe.subject in subjects for model in probe.templates
    }
    quantities = compared_quantities(loaded, templates) + derived_quantities()
    entries = first_of_each(json.loads((given.data / "INDEX.json").read_text(encoding="utf-8")), given.limit)
    values = collect(given.data, entries, quantities, given.seed, given.products)
    print("\n\n".join(table(quantity, values) for quantity in quantities))


if __name__ == "__main__":
    main()
