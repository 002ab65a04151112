"""Order the runs of each pair by the no-reference score and compare with the truth: `make bench-score`.

    TERREX_DATA=... python -m benchmarks.quality_score [--cache build/quality] [--every N] [--folds 5]

Makes the runs that the cache lacks (`benchmarks.quality_runs`), then predicts every run by tables of confidence that
were fitted to other scenes. The score of a run is the expected share of pixels that are right; picking for each pair
and distortion the configuration with the best score is compared with the best single configuration (on all but the
scenes at hand) and with the best for each pair, which only the truth knows. Beside it: picking by density alone, and
how the expected share of wrong pixels among the valid ones goes along with the true one, at equal density.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from benchmarks.calibrate_confidence import NOT_PAIRS, Runs, fit_confidence, left_out, predict, read_runs
from benchmarks.quality_runs import CONFIGURATIONS, fill_cache

Floats = NDArray[np.float64]
NAMES = list(CONFIGURATIONS)
DENSITY_BINS = (0, 30, 50, 60, 70, 75, 80, 85, 90, 95, 101)  # %, runs of one bin count as equally dense


def by_pair(runs: Runs, values: Floats) -> tuple[Floats, NDArray[np.str_]]:
    """Return one row per development pair and distortion with all configurations, and the group of each row."""
    rows: dict[tuple[str, str], dict[str, int]] = {}
    for index, (case, kind, group, configuration) in enumerate(runs.names):
        if kind not in NOT_PAIRS and not group.startswith("terrain"):
            rows.setdefault((case, kind), {})[configuration] = index
    complete = [row for row in rows.values() if len(row) == len(NAMES)]
    table = np.array([[values[row[name]] for name in NAMES] for row in complete])
    return table, np.array([runs.names[row[NAMES[0]]][2] for row in complete])


def best_single(bad: Floats, groups: NDArray[np.str_]) -> Floats:
    """Return the error of the configuration that is best on the scenes of all other groups, per row."""
    found = np.empty(len(bad))
    for group in set(groups):
        own = groups == group
        found[own] = bad[own, bad[~own].mean(axis=0).argmin()]
    return found


def show_picking(name: str, score: Floats, bad: Floats, groups: NDArray[np.str_]) -> None:
    """Print the error of what the score picks, between best single configuration and best for each pair."""
    picked = bad[np.arange(len(bad)), score.argmax(axis=1)].mean()
    single, least = best_single(bad, groups).mean(), bad.min(axis=1).mean()
    worst = bad.mean()
    print(
        f"  {name:22s} bad-1 {picked:6.2f} %   gap closed {(single - picked) / (single - least):6.2f}"
        f"   of the way from any configuration to the best {(worst - picked) / (worst - least):5.3f}"
    )


def at_equal_density(runs: Runs, expected: Floats) -> tuple[float, float]:
    """Return the rank correlation of expected and true wrong-among-valid, over all runs and within bins of density."""
    use = np.array([kind not in NOT_PAIRS and not group.startswith("terrain") for _, kind, group, _ in runs.names])
    true, density, said = runs.wrong[use], 100 * runs.density[use], expected[use]
    bins = np.digitize(density, DENSITY_BINS)
    parts = [(spearmanr(said[bins == b], true[bins == b])[0], int((bins == b).sum())) for b in set(bins)]
    parts = [(value, count) for value, count in parts if count >= 20]
    return float(spearmanr(said, true)[0]), float(np.average([p[0] for p in parts], weights=[p[1] for p in parts]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--cache", type=Path, default=Path("build/quality"))
    parser.add_argument("--every", type=int, default=1, help="take every N-th pair only")
    parser.add_argument(
        "--folds", type=int, default=5, help="number of parts that the groups of scenes are left out in"
    )
    args = parser.parse_args()
    if args.data:
        fill_cache(args.cache, Path(args.data), args.every)
    runs = read_runs(args.cache)
    confidence = left_out(runs, ~np.isnan(runs.error_px), args.folds, fit_confidence, predict)
    count = np.maximum(np.bincount(runs.run, minlength=len(runs.names)), 1)
    believed = np.bincount(runs.run, confidence, minlength=len(runs.names)) / count
    bad, groups = by_pair(runs, runs.bad)
    score, density = by_pair(runs, believed * runs.density)[0], by_pair(runs, runs.density)[0]
    print(f"{len(bad)} pairs x distortions of {len(set(groups))} groups of scenes, {len(NAMES)} configurations")
    print(f"  {'best single':22s} bad-1 {best_single(bad, groups).mean():6.2f} %")
    print(f"  {'best for each pair':22s} bad-1 {bad.min(axis=1).mean():6.2f} %")
    show_picking("picked by score", score, bad, groups)
    show_picking("picked by density", density, bad, groups)
    whole, equal = at_equal_density(runs, 1 - believed)
    print(f"rank correlation of expected and true wrong among valid: {whole:.2f}; at equal density {equal:.2f}")
    print(f"{'configuration':28s} {'bad-1':>6s} {'expected':>9s} {'picked':>7s} {'lost by picking':>16s}")
    picks = score.argmax(axis=1)
    lost = bad[np.arange(len(bad)), picks] - bad.min(axis=1)
    for index, name in enumerate(NAMES):
        mine = picks == index
        expected = 100 * (1 - score[:, index].mean())
        numbers = f"{bad[:, index].mean():6.1f} {expected:9.1f} {mine.sum():7d} {lost[mine].sum() / len(bad):16.2f}"
        print(f"{name:28s} {numbers}")


if __name__ == "__main__":
    main()
