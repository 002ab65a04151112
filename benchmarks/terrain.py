"""Measure the elevation map against rendered terrain with exact truth.

    python -m benchmarks.terrain [--seeds 5] [--roll 5] [--pitch -8] [--distortion clean] [--no-attitude]

Prints, per seed and over all: median and 90th percentile of the absolute elevation error within 6 m of the camera, the
share of errors within 2 predicted sigma, the robust spread of error over sigma, and the share of visible cells within
5 m that are known.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from expert import ExpertSystem, StereoPair
from modules.simulation import TerrainParams, distort_right, render_terrain
from modules.simulation.terrain import RenderedPair
from modules.types import ElevationMap, Views

NEAR_M, COVERAGE_M = 6.0, 5.0
SEEN_FRACTION = 0.25  # of a cell that the camera must see before the cell counts as visible


def distances(grid: ElevationMap) -> NDArray[np.float64]:
    """Return the horizontal distance of every cell's centre from the origin, m."""
    rows, columns = grid.shape
    x = grid.x0_m + (np.arange(columns) + 0.5) * grid.cell_m
    y = grid.y0_m + (np.arange(rows) + 0.5) * grid.cell_m
    return np.hypot(x[None, :], y[:, None])


def score(made: RenderedPair, grid: ElevationMap) -> tuple[float, ...]:
    """Return median and 90 % error in cm, share within 2 sigma, robust spread, and coverage, both in %."""
    truth = made.true_elevation(grid.x0_m, grid.y0_m, grid.cell_m, grid.shape)
    elevation, sigma = grid.layers["elevation"], grid.layers["sigma_m"]
    measured = np.isfinite(elevation) & (grid.layers["filled"] == 0)
    known = measured & np.isfinite(truth.layers["elevation"]) & (distances(grid) <= NEAR_M)
    error = (elevation - truth.layers["elevation"])[known]
    relative = error / sigma[known]
    spread = 1.48 * float(np.median(np.abs(relative - np.median(relative))))
    visible = made.elevation.layers["visible_fraction"] >= SEEN_FRACTION
    visible &= distances(made.elevation) <= COVERAGE_M
    return (
        100 * float(np.median(np.abs(error))),
        100 * float(np.percentile(np.abs(error), 90)),
        100 * float(np.mean(np.abs(relative) <= 2)),
        spread,
        100 * covered(made.elevation, visible, grid),
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--roll", type=float, default=5.0)
    parser.add_argument("--pitch", type=float, default=-8.0)
    parser.add_argument("--distortion", default="clean")
    parser.add_argument("--no-attitude", action="store_true", help="fit the ground plane instead")
    args = parser.parse_args()
    system = ExpertSystem()
    print(f"{'seed':>6s} {'median cm':>10s} {'90 % cm':>10s} {'in 2 sigma':>10s} {'spread':>10s} {'covered %':>10s}")
    rows = []
    for seed in range(100, 100 + args.seeds):
        made = render_terrain(TerrainParams(seed=seed, roll_deg=args.roll, pitch_deg=args.pitch))
        views = distort_right(Views(made.left, made.right), args.distortion, seed=seed)
        attitude = None if args.no_attitude else made.attitude
        pair = StereoPair(
            views.left, views.right, calibration=made.calibration, attitude=attitude, mount=made.mount, name=str(seed)
        )
        result = system.reconstruct(pair)
        if result.elevation is None:
            print(f"{seed:6d} no elevation map: {result.decision.findings[0].sentence}")
            continue
        rows.append(score(made, result.elevation))
        print(f"{seed:6d} " + " ".join(f"{value:10.2f}" for value in rows[-1]))
    if rows:
        print(f"{'median':>6s} " + " ".join(f"{value:10.2f}" for value in np.median(rows, axis=0)))


if __name__ == "__main__":
    main()
