"""Measure the rules of correction before a fixed matcher: `make bench-correction-rules`.

    TERREX_DATA=... python -m benchmarks.correction_rules [--every N] [--short] [--keep FILE]

The matcher is always OpenCV's semi-global one with three paths and a block of 5 px, the disparity range is given, and
the usual checks follow. Over development pairs x reference distortions, mean bad-1 in % (missing counted as wrong) of

- no correction, every operator of the catalog with its defaults on every pair, and some fixed combinations;
- what the shipped rules choose, told by a layered rule that this matcher follows.

Below stand, per distortion, the rules' error over that of the best fixed correction for it, and the rules' error on
misrectified pairs over that on clean ones. Repeated with other strengths (--strength), it shows what was fitted.

All fixed corrections on all pairs take an hour. With --keep their errors are written to a file as they come, and those
that stand there already are not computed again; the rules' are.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.pairs import bad_1_percent
from expert import ExpertSystem, StereoPair
from modules.catalog import operators, probes
from modules.correction import OPERATORS
from modules.formats.datasets import DatasetPair, read_index
from modules.measurement.sample import Sample
from modules.operator import OperatorError
from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right
from modules.types import DisparityRange, Matching, Views

Step = tuple[str, Mapping[str, Any]]
ALIGN = "align"  # stands for the alignment that the pair's own matches give
MATCHER: Sequence[Step] = (
    ("matching.semi_global_block_match", {"mode": "3way", "block_px": 5}),
    ("matching.check_left_right", {}),
    ("matching.remove_speckles", {}),
)
FOLLOWS = """version: 1
rules:
  - id: BEN001
    name: this-matcher-follows
    stage: correction
    when: [{fact: task}]
    then: [{derive: intensities-compared}]
    because: The benchmark matches every pair with the matcher that compares intensities.
    references: ["benchmarks/correction_rules.py"]
"""
RULES = "rules"
SHORT = (
    "none", "match_histograms", "fit_gain_offset", "normalise_local_contrast", "transfer_local_affine",
    "subtract_bilateral_background", "denoise_gaussian", "align", "align + match_histograms",
    "align + transfer_local_affine",
)  # fmt: skip


def fixed_corrections(short: bool) -> dict[str, tuple[Step, ...]]:
    """Return the corrections that look at no pair: every operator but the masks, and combinations."""
    singles = {
        operator.name.split(".")[1]: ((operator.name, {}),)
        for operator in OPERATORS
        if operator.slot not in ("align", "masks")
    }
    combined = {
        "align": ((ALIGN, {}),),
        **{
            f"align + {name}": ((ALIGN, {}), (f"correction.{name}", {}))
            for name in ("match_histograms", "normalise_local_contrast", "transfer_local_affine")
        },
        "align + match_histograms + transfer_local_affine": (
            (ALIGN, {}),
            ("correction.match_histograms", {}),
            ("correction.transfer_local_affine", {}),
        ),
    }
    every = {"none": (), **singles, **combined}
    return {name: steps for name, steps in every.items() if not short or name in SHORT}


def aligned(views: Views) -> Views:
    """Align rows as measured, whatever the measurement says about itself."""
    fact = probes()["measurement.row_alignment"].function(Sample(views))[0]
    if getattr(fact, "offset_px", None) is None:
        return views
    operator = operators()["correction.align_rows"]
    try:
        given = operator.params(offset_px=fact.offset_px, roll_deg=fact.roll_deg, row_scale=fact.scale)
    except ValueError:
        return views  # beyond what the operator takes
    return operator.function(views, given)


def correct(views: Views, steps: Sequence[Step]) -> Views:
    """Run operators; one that refuses the pair leaves it as it was."""
    for name, values in steps:
        try:
            views = (
                aligned(views)
                if name == ALIGN
                else operators()[name].function(views, operators()[name].params(**values))
            )
        except OperatorError:
            continue
    return views


def chosen(system: ExpertSystem, pair: DatasetPair, views: Views) -> tuple[Step, ...]:
    """Return what the rules choose for a pair."""
    decision = system.decide(StereoPair(views.left, views.right, disparity_range_px=(0, pair.ndisp)))
    steps = decision.plans["correction"].steps if "correction" in decision.plans else ()
    return tuple((step.operator, dict(step.parameters)) for step in steps if step.operator != "none")


def bad_1(pair: DatasetPair, views: Views) -> float:
    state = Matching(views, DisparityRange(0, pair.ndisp))
    for name, values in MATCHER:
        state = operators()[name].function(state, operators()[name].params(**values))
    assert state.disparity is not None
    return bad_1_percent(state.disparity.disparity_px, pair)


class Kept:
    """Errors of fixed corrections that an earlier run left in a file of JSON lines, and a place to add more."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        lines = path.read_text(encoding="utf-8").splitlines() if path and path.exists() else []
        self._known = {tuple(key): error for key, error in map(json.loads, lines)}

    def get(self, key: tuple[str, ...], compute: Callable[[], float]) -> float:
        """Return the error for a key, computed and added where it is not known."""
        if key not in self._known:
            self._known[key] = compute()
            if self._path:
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps([key, self._known[key]]) + "\n")
        return self._known[key]


def measure(
    folder: Path, every: int, short: bool, strength: float, kept: Kept
) -> tuple[dict[tuple[str, str], list[float]], dict[str, Counter[str]]]:
    """Return the errors by correction and distortion, and what the rules chose per distortion."""
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "follows.yaml"
        file.write_text(FOLLOWS, encoding="utf-8")
        system = ExpertSystem(rules=[file], engine="compiled")
    errors: dict[tuple[str, str], list[float]] = {}
    plans: dict[str, Counter[str]] = {kind: Counter() for kind in REFERENCE_DISTORTIONS}
    for number, pair in enumerate(read_index(folder, "dev")):
        if number % every:
            continue
        for kind in REFERENCE_DISTORTIONS:
            views = distort_right(pair.views, kind, seed=number, strength=strength)
            steps = chosen(system, pair, views)
            plans[kind][" + ".join(name.split(".")[1] for name, _ in steps) or "nothing"] += 1
            errors.setdefault((RULES, kind), []).append(bad_1(pair, correct(views, steps)))
            for name, fixed in fixed_corrections(short).items():
                key = (f"{number} {pair.name}", kind, f"{strength:g}", name)
                error = kept.get(key, partial(_corrected_bad_1, pair, views, fixed))
                errors.setdefault((name, kind), []).append(error)
    return errors, plans


def _corrected_bad_1(pair: DatasetPair, views: Views, steps: Sequence[Step]) -> float:
    return bad_1(pair, correct(views, steps))


def report(errors: dict[tuple[str, str], list[float]], plans: dict[str, Counter[str]]) -> None:
    kinds = list(REFERENCE_DISTORTIONS)
    names = sorted({name for name, _ in errors}, key=lambda name: float(mean_of(errors, name, kinds)))
    print(f"{'mean bad-1 in %':50s}" + "".join(f"{kind[:9]:>10s}" for kind in kinds) + f"{'mean':>8s}")
    for name in names:
        row = "".join(f"{np.mean(errors[name, kind]):10.2f}" for kind in kinds)
        print(f"{name:50s}{row}{mean_of(errors, name, kinds):8.2f}")
    fixed = [name for name in names if name != RULES]
    best = {kind: min(fixed, key=lambda name: float(np.mean(errors[name, kind]))) for kind in kinds}
    ratios = [np.mean(errors[RULES, kind]) / np.mean(errors[best[kind], kind]) for kind in kinds]
    print(f"{'rules over the best fixed correction of the kind':50s}" + "".join(f"{ratio:10.3f}" for ratio in ratios))
    print("\nbest of the kind: " + ", ".join(f"{kind}: {best[kind]}" for kind in kinds))
    means = [mean_of(errors, name, kinds) for name in (fixed[0], RULES)]
    print(f"best fixed correction: {fixed[0]} {means[0]:.2f}, rules {means[1]:.2f}")
    print(f"misrectified over clean: {np.mean(errors[RULES, 'misrectified']) / np.mean(errors[RULES, 'clean']):.3f}")
    for kind in kinds:
        print(f"{kind:14s}" + "; ".join(f"{count} x {plan}" for plan, count in plans[kind].most_common()))


def mean_of(errors: dict[tuple[str, str], list[float]], name: str, kinds: Sequence[str]) -> float:
    return float(np.mean([np.mean(errors[name, kind]) for kind in kinds]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--every", type=int, default=1, help="take every N-th pair only")
    parser.add_argument(
        "--short", action="store_true", help="leave out fixed corrections that never come near the best"
    )
    parser.add_argument("--strength", type=float, default=1.0, help="of the distortions")
    parser.add_argument("--keep", type=Path, help="file for the errors of fixed corrections, read first")
    args = parser.parse_args()
    if not args.data:
        raise SystemExit("no data: set TERREX_DATA or give --data FOLDER")
    report(*measure(Path(args.data), args.every, args.short, args.strength, Kept(args.keep)))


if __name__ == "__main__":
    main()
