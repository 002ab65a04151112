"""Measure terrex against fixed configurations over development pairs x reference distortions.

    TERREX_DATA=... python -m benchmarks.accuracy [--every N] [--profile balanced] [--estimate-range]

Prints mean bad-1 (missing counted as wrong), wrong among valid, density and CPU seconds per distortion and system. The
fixed configurations are given the disparity range; terrex is too, unless --estimate-range is said.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from expert import ExpertSystem, StereoPair
from modules.catalog import operators
from modules.formats.datasets import DatasetPair, read_index
from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right
from modules.types import DisparityRange, FloatImage, Matching, Views

BAD_PX = 1.0
CHECKS = ("matching.check_left_right", "matching.remove_speckles")
FIXED: dict[str, tuple[tuple[str, dict], ...]] = {
    "robust matcher": (("matching.semi_global_match", {}),),
    "histogram matching + SGBM": (
        ("correction.match_histograms", {"channels": "each"}),
        ("matching.semi_global_block_match", {}),
    ),
    "SGBM": (("matching.semi_global_block_match", {}),),
}
System = Callable[[Views, int], FloatImage]


def fixed(steps: tuple[tuple[str, dict], ...]) -> System:
    """Return a system that always runs the same steps, and the usual checks."""
    catalog = operators()

    def run(views: Views, ndisp: int) -> FloatImage:
        state = Matching(views, DisparityRange(0, ndisp))
        for name, values in (*steps, *((check, {}) for check in CHECKS)):
            operator = catalog[name]
            if operator.stage == "correction":
                state = Matching(operator.function(state.views, operator.params(**values)), state.range_px)
            else:
                state = operator.function(state, operator.params(**values))
        assert state.disparity is not None
        return state.disparity.disparity_px

    return run


def expert(profile: str, estimate_range: bool) -> System:
    """Return terrex as a system."""
    system = ExpertSystem(profile=profile)

    def run(views: Views, ndisp: int) -> FloatImage:
        range_px = None if estimate_range else (0, ndisp)
        return system.reconstruct(StereoPair(views.left, views.right, disparity_range_px=range_px)).disparity_px

    return run


def score(disparity_px: FloatImage, pair: DatasetPair) -> tuple[float, float, float]:
    """Return bad-1 with missing counted as wrong, wrong among valid, and density, in %."""
    assert pair.truth_px is not None
    assert pair.scored is not None
    error = np.abs(disparity_px - pair.truth_px)[pair.scored]
    valid = np.isfinite(error)
    wrong = 100.0 * float(np.mean(error[valid] > BAD_PX)) if valid.any() else 0.0
    return 100.0 * float(np.mean(~(error <= BAD_PX))), wrong, 100.0 * float(valid.mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--every", type=int, default=1, help="take every N-th pair only")
    parser.add_argument("--profile", default="balanced")
    parser.add_argument("--estimate-range", action="store_true", help="terrex is not given the disparity range")
    args = parser.parse_args()
    if not args.data:
        raise SystemExit("no data: set TERREX_DATA or give --data FOLDER")
    systems = {f"terrex {args.profile}": expert(args.profile, args.estimate_range)}
    systems |= {name: fixed(steps) for name, steps in FIXED.items()}
    results: dict[tuple[str, str], list[tuple[float, ...]]] = {}
    for number, pair in enumerate(read_index(Path(args.data), "dev")):
        if number % args.every:
            continue
        for kind in REFERENCE_DISTORTIONS:
            views = distort_right(pair.views, kind, seed=number)
            for name, system in systems.items():
                start = time.process_time()
                disparity = system(views, pair.ndisp)
                spent = time.process_time() - start
                results.setdefault((name, kind), []).append((*score(disparity, pair), spent))
    report(results, list(systems))


def report(results: dict[tuple[str, str], list[tuple[float, ...]]], systems: list[str]) -> None:
    """Print a table per system, one row per distortion and one for all."""
    for name in systems:
        print(f"\n{name}\n  {'distortion':14s} {'bad-1 %':>8s} {'wrong %':>8s} {'density':>8s} {'CPU s':>8s}")
        rows = {kind: results[name, kind] for kind in REFERENCE_DISTORTIONS}
        for kind, values in (*rows.items(), ("all", [value for row in rows.values() for value in row])):
            print(f"  {kind:14s} " + " ".join(f"{number:8.2f}" for number in np.mean(values, axis=0)))


if __name__ == "__main__":
    main()
