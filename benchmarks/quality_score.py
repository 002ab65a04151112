"""Order the runs of each pair by the no-reference score and compare with the truth: `make bench-score`.

    TERREX_DATA=... python -m benchmarks.quality_score [--cache build/quality] [--every N] [--full] [--write]

Makes the runs that the cache lacks (`benchmarks.quality_runs`), then scores every run by tables of confidence and
weights that were fitted to other scenes. Picking for each pair and distortion the configuration with the best score is
compared with the best single configuration (on all but the scenes at hand) and with the best for each pair, which only
the truth knows: 1 is the whole gap between these. Beside it: picking by density alone and by the confidence alone, and
how the expected share of wrong pixels among the valid ones goes along with the true one, at equal density.

The weights of the score (`modules.primitives.merit`) are fitted to differences between configurations on the same pair,
so that the difficulty of a pair is no part of it, and most to the configurations that come near the best. `--write`
writes `modules/primitives/merit_weights.py`, fitted to all scenes.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from benchmarks.calibrate_confidence import MAP_NODES, Runs, fit_confidence, left_out, predict, read_runs
from benchmarks.quality_runs import fill_cache
from expert.evaluate.grid import fixed_grid

Floats = NDArray[np.float64]
NAMES = tuple(fixed_grid())
OWN = ("robust", "census")  # matchers of terrex; the others are OpenCV's
SETS = {
    "OpenCV's matchers": tuple(name for name in NAMES if not name.endswith(OWN)),
    "all configurations": NAMES,
}
FEATURES = ("expected", "density", "agreement", "roughness", "edges")
NEAR_PERCENT = 5.0  # a configuration this much worse than the best of its pair has half the weight
RIDGE = 3.0
DENSITY_BINS = (0, 30, 50, 60, 70, 75, 80, 85, 90, 95, 101)  # %, runs of one bin count as equally dense
WEIGHTS = Path("modules/primitives/merit_weights.py")


@dataclass(frozen=True)
class Table:
    """Runs of a set of configurations: one row per development pair and distortion.

    Attributes
    ----------
    features : float64 (rows, configurations, features)
    bad, density : float64 (rows, configurations)
        Of the scored pixels missing or wrong, %; of all pixels with a disparity, 0-1.
    groups : str (rows,)
        Scene of each row.
    """

    features: Floats
    bad: Floats
    density: Floats
    groups: NDArray[np.str_]


def features_of(runs: Runs, believed: Floats) -> Floats:
    """Return the features of each run (R, features) from its mean confidence; missing ones as `map_features` does."""
    whole = {kind: np.nan_to_num(column) for kind, column in zip(MAP_NODES, runs.whole.T, strict=True)}
    known = {"expected": believed * runs.density, "density": runs.density, "edges": runs.edges, **whole}
    return np.column_stack([known[name] for name in FEATURES])


def table_of(runs: Runs, features: Floats, names: tuple[str, ...]) -> Table:
    """Arrange the runs of some configurations by pair and distortion; pairs that lack one are left out."""
    rows: dict[tuple[str, str], dict[str, int]] = {}
    for index, (case, kind, _, configuration) in enumerate(runs.names):
        if not (runs.hopeless[index] or runs.terrain[index]) and configuration in names:
            rows.setdefault((case, kind), {})[configuration] = index
    order = np.array([[row[name] for name in names] for row in rows.values() if len(row) == len(names)])
    return Table(features[order], runs.bad[order], runs.density[order], runs.column(2)[order[:, 0]])


def fit_weights(tables: list[tuple[Table, NDArray[np.bool_]]]) -> Floats:
    """Return the weight of each feature: the bad pixels avoided, %, within pairs, rows and their choice given."""
    parts, targets, shares = [], [], []
    for table, rows in tables:
        bad = table.bad[rows]
        near = 1 / (1 + ((bad - bad.min(axis=1, keepdims=True)) / NEAR_PERCENT) ** 2)
        total = near.sum(axis=1, keepdims=True)
        centre = (table.features[rows] * near[..., None]).sum(axis=1, keepdims=True) / total[..., None]
        parts.append((table.features[rows] - centre).reshape(-1, len(FEATURES)))
        targets.append((bad - (bad * near).sum(axis=1, keepdims=True) / total).ravel())
        shares.append(near.ravel())
    x, y, w = np.vstack(parts), np.concatenate(targets), np.concatenate(shares)
    scale = x.std(axis=0)
    x = x / scale
    return -np.linalg.solve((x * w[:, None]).T @ x + RIDGE * np.eye(len(scale)), (x * w[:, None]).T @ y) / scale


def scores_left_out(tables: list[Table]) -> list[Floats]:
    """Return the score of every run of every table, each by weights fitted to all other scenes."""
    found = [np.empty(table.bad.shape) for table in tables]
    for group in sorted({group for table in tables for group in table.groups}):
        weights = fit_weights([(table, table.groups != group) for table in tables])
        for score, table in zip(found, tables, strict=True):
            own = table.groups == group
            score[own] = table.features[own] @ weights
    return found


def best_single(bad: Floats, groups: NDArray[np.str_]) -> Floats:
    """Return the error of the configuration that is best on the scenes of all other groups, per row."""
    found = np.empty(len(bad))
    for group in set(groups):
        own = groups == group
        found[own] = bad[own, bad[~own].mean(axis=0).argmin()]
    return found


def show_picking(name: str, score: Floats, table: Table) -> None:
    """Print the error of what a score picks, between best single configuration and best for each pair."""
    picked = table.bad[np.arange(len(table.bad)), score.argmax(axis=1)].mean()
    single, least = best_single(table.bad, table.groups).mean(), table.bad.min(axis=1).mean()
    print(f"  {name:22s} bad-1 {picked:6.2f} %   gap closed {(single - picked) / (single - least):6.2f}")


def at_equal_density(runs: Runs, expected: Floats) -> tuple[float, float]:
    """Return the rank correlation of expected and true wrong-among-valid, over all runs and within bins of density."""
    use = ~(runs.hopeless | runs.terrain | runs.patched)
    true, density, said = runs.wrong[use], 100 * runs.density[use], expected[use]
    bins = np.digitize(density, DENSITY_BINS)
    parts = [(spearmanr(said[bins == b], true[bins == b])[0], int((bins == b).sum())) for b in set(bins)]
    parts = [(value, count) for value, count in parts if count >= 20]
    return float(spearmanr(said, true)[0]), float(np.average([p[0] for p in parts], weights=[p[1] for p in parts]))


def show_configurations(score: Floats, table: Table, names: tuple[str, ...]) -> None:
    """Print what each configuration is like and what picking it by the score costs."""
    print(f"  {'configuration':26s} {'bad-1':>6s} {'density':>8s} {'picked':>7s} {'lost by picking':>16s}")
    picks = score.argmax(axis=1)
    lost = table.bad[np.arange(len(table.bad)), picks] - table.bad.min(axis=1)
    for index, name in enumerate(names):
        mine = picks == index
        numbers = f"{table.bad[:, index].mean():6.1f} {100 * table.density[:, index].mean():8.1f} {mine.sum():7d}"
        print(f"  {name:26s} {numbers} {lost[mine].sum() / len(table.bad):16.2f}")


def write_weights(tables: list[Table]) -> None:
    """Write the weights as a module, for scores that are shares; the constant makes their mean right."""
    weights = fit_weights([(table, np.ones(len(table.groups), bool)) for table in tables]) / 100
    every = tables[-1]
    constant = float(np.mean(1 - every.bad / 100) - np.mean(every.features @ weights))
    lines = [
        '"""Weights of the merit of a map; written by `python -m benchmarks.quality_score --write`.',
        "",
        f"Fitted to {every.bad.size} runs of {len(set(every.groups))} groups of scenes.",
        '"""',
        "",
        "from __future__ import annotations",
        "",
        f"CONSTANT = {constant:.4f}",
        "WEIGHTS = {",
        *(f'    "{name}": {weight:.5f},' for name, weight in zip(FEATURES, weights, strict=True)),
        "}",
    ]
    WEIGHTS.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--cache", type=Path, default=Path("build/quality"))
    parser.add_argument("--every", type=int, default=1, help="take every N-th pair only")
    parser.add_argument("--full", action="store_true", help="every pair with all ten distortions")
    parser.add_argument("--folds", type=int, default=5, help="parts that the scenes are left out in")
    parser.add_argument("--write", action="store_true", help=f"write {WEIGHTS}")
    args = parser.parse_args()
    if args.data:
        fill_cache(args.cache, Path(args.data), args.every, args.full)
    runs = read_runs(args.cache)
    confidence = left_out(runs, ~np.isnan(runs.error_px), args.folds, fit_confidence, predict)
    count = np.bincount(runs.run, minlength=len(runs.names))
    believed = np.bincount(runs.run, confidence, minlength=len(runs.names)) / np.maximum(count, 1)
    features = features_of(runs, believed)
    tables = [table_of(runs, features, names) for names in SETS.values()]
    for (title, names), table, score in zip(SETS.items(), tables, scores_left_out(tables), strict=True):
        print(f"{title}: {len(names)}, on {len(table.bad)} pairs x distortions of {len(set(table.groups))} scenes")
        print(f"  {'best single':22s} bad-1 {best_single(table.bad, table.groups).mean():6.2f} %")
        print(f"  {'best for each pair':22s} bad-1 {table.bad.min(axis=1).mean():6.2f} %")
        show_picking("picked by score", score, table)
        show_picking("picked by confidence", table.features[..., 0], table)
        show_picking("picked by density", table.density, table)
        show_configurations(score, table, names)
    whole, equal = at_equal_density(runs, 1 - believed)
    print(f"rank correlation of expected and true wrong among valid: {whole:.2f}; at equal density {equal:.2f}")
    if args.write:
        write_weights(tables)
        print(f"wrote {WEIGHTS}")


if __name__ == "__main__":
    main()
