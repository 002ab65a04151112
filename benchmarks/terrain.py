"""Measure the elevation map against rendered terrain with exact truth, and compare with the bars: `make bench-terrain`.

    python -m benchmarks.terrain [--seeds 20] [--first 100] [--distortions clean,dark] [--no-attitude]
                                [--rules FILE]

Each seed has its own terrain and attitude, at most 15 degrees from level in any direction. Printed are, as medians over
the seeds: median and 90th percentile of the absolute elevation error within 6 m, the share of errors within 2 predicted
sigma, the robust spread (1.48 MAD) of error over sigma, the share of visible cells within 5 m that are known; over all
seeds together: rocks higher than 15 cm found as hazards, and the part of the hazard area that is near such ground that
the truth calls hazardous. For a distortion the last column is its median error over that of the clean pairs.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.hazards import Hazards, score_hazards
from expert import ExpertSystem, StereoPair
from modules.simulation import REFERENCE_DISTORTIONS, TerrainParams, distort_right, render_terrain
from modules.simulation.terrain import RenderedPair
from modules.types import ElevationMap, Views

NEAR_M, COVERAGE_M = 6.0, 5.0
SEEN_FRACTION = 0.25  # of a cell that the camera must see before the cell counts as visible
MAX_TILT_DEG = 15.0
RATIO_BARS = {"noise": 2.0, "blur": 2.0, "misrectified": 2.0}
PHOTOMETRIC_RATIO = 1.5


@dataclass(frozen=True)
class Score:
    """What was measured of one reconstruction; errors in cm, shares in %."""

    median_cm: float
    p90_cm: float
    within_two_sigma: float
    spread: float
    covered: float
    hazards: Hazards


def attitude_of(seed: int) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in degrees of a seed: a tilt of at most 15 degrees in any direction, any heading."""
    rng = np.random.default_rng(seed)
    tilt, direction = MAX_TILT_DEG * np.sqrt(rng.uniform()), rng.uniform(0.0, 2.0 * np.pi)
    return float(tilt * np.cos(direction)), float(tilt * np.sin(direction)), float(rng.uniform(-180.0, 180.0))


def rendered(seed: int) -> RenderedPair:
    roll, pitch, yaw = attitude_of(seed)
    return render_terrain(TerrainParams(seed=seed, roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw))


def pair_of(made: RenderedPair, distortion: str, seed: int, attitude: bool) -> StereoPair:
    views = distort_right(Views(made.left, made.right), distortion, seed=seed)
    return StereoPair(
        views.left,
        views.right,
        calibration=made.calibration,
        attitude=made.attitude if attitude else None,
        mount=made.mount,
        name=f"{seed}, {distortion}",
    )


def distances(grid: ElevationMap) -> NDArray[np.float64]:
    """Return the horizontal distance of every cell's centre from the origin, m."""
    rows, columns = grid.shape
    x = grid.x0_m + (np.arange(columns) + 0.5) * grid.cell_m
    y = grid.y0_m + (np.arange(rows) + 0.5) * grid.cell_m
    return np.hypot(x[None, :], y[:, None])


def score(made: RenderedPair, grid: ElevationMap) -> Score:
    """Compare an elevation map with the truth."""
    truth = made.true_elevation(grid.x0_m, grid.y0_m, grid.cell_m, grid.shape)
    elevation, sigma = grid.layers["elevation"], grid.layers["sigma_m"]
    measured = np.isfinite(elevation) & (grid.layers["filled"] == 0)
    known = measured & np.isfinite(truth.layers["elevation"]) & (distances(grid) <= NEAR_M)
    error = (elevation - truth.layers["elevation"])[known]
    relative = error / sigma[known]
    visible = made.elevation.layers["visible_fraction"] >= SEEN_FRACTION
    visible &= distances(made.elevation) <= COVERAGE_M
    return Score(
        100 * float(np.median(np.abs(error))),
        100 * float(np.percentile(np.abs(error), 90)),
        100 * float(np.mean(np.abs(relative) <= 2)),
        1.48 * float(np.median(np.abs(relative - np.median(relative)))),
        100 * covered(made.elevation, visible, grid),
        score_hazards(made, grid),
    )


def covered(truth: ElevationMap, visible: NDArray[np.bool_], grid: ElevationMap) -> float:
    """Return the share of visible cells of the truth whose centre lies in a known cell of the map."""
    i, j = np.nonzero(visible)
    x = truth.x0_m + (j + 0.5) * truth.cell_m
    y = truth.y0_m + (i + 0.5) * truth.cell_m
    row = np.floor((y - grid.y0_m) / grid.cell_m).astype(int)
    column = np.floor((x - grid.x0_m) / grid.cell_m).astype(int)
    inside = (row >= 0) & (row < grid.shape[0]) & (column >= 0) & (column < grid.shape[1])
    known = np.zeros(len(i), bool)
    known[inside] = np.isfinite(grid.layers["elevation"][row[inside], column[inside]])
    return float(known.mean()) if len(known) else 0.0


def summary(scores: Sequence[Score]) -> tuple[float, ...]:
    """Return the medians over the seeds, then recall and explained area, in %, over all of them."""
    rows = [(s.median_cm, s.p90_cm, s.within_two_sigma, s.spread, s.covered) for s in scores]
    total = sum((s.hazards for s in scores), Hazards())
    return (*np.median(rows, axis=0).tolist(), 100 * total.recall, 100 * total.explained)


def verdicts(values: tuple[float, ...]) -> list[str]:
    """Return the bars that clean pairs miss."""
    median, p90, within, spread, coverage, recall, explained = values
    bars = [
        (median <= 2.0, "median <= 2 cm"),
        (p90 <= 6.0, "90th percentile <= 6 cm"),
        (90.0 <= within <= 98.0, "90-98 % within 2 sigma"),
        (0.8 <= spread <= 1.25, "spread 0.8-1.25"),
        (coverage >= 90.0, "coverage >= 90 %"),
        (recall >= 95.0, "recall >= 95 %"),
        (explained >= 90.0, "explained >= 90 %"),
    ]
    return [words for met, words in bars if not met]


def measure(seeds: range, distortions: list[str], attitude: bool, rules: Sequence[str] = ()) -> None:
    system = ExpertSystem(rules=rules)
    scores: dict[str, list[Score]] = {name: [] for name in distortions}
    for seed in seeds:
        made = rendered(seed)
        for name in distortions:
            result = system.reconstruct(pair_of(made, name, seed, attitude))
            if result.elevation is None:
                print(f"{seed} {name}: no elevation map: {result.decision.findings[0].sentence}")
                continue
            scores[name].append(score(made, result.elevation))
    head = ("median cm", "90 % cm", "in 2 sigma", "spread", "covered", "rocks", "explained", "ratio")
    print(f"{'':14s}" + " ".join(f"{title:>10s}" for title in head))
    clean = float("nan")
    for name, found in scores.items():
        if not found:
            continue
        values = summary(found)
        clean = values[0] if name == "clean" else clean
        ratio = values[0] / clean
        print(f"{name:14s}" + " ".join(f"{value:10.2f}" for value in (*values, ratio)))
        if name == "clean":
            print("  bars: " + (", ".join(f"MISSED {bar}" for bar in verdicts(values)) or "all met"))
        elif ratio > RATIO_BARS.get(name, PHOTOMETRIC_RATIO):
            print(f"  bar: MISSED ratio <= {RATIO_BARS.get(name, PHOTOMETRIC_RATIO)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--distortions", default=",".join(REFERENCE_DISTORTIONS))
    parser.add_argument("--no-attitude", action="store_true", help="fit the ground plane instead")
    parser.add_argument("--rules", action="append", default=[], help="rule file layered on the shipped ones")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    measure(seeds, args.distortions.split(","), not args.no_attitude, args.rules)


if __name__ == "__main__":
    main()
