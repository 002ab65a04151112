"""CPU time of the reconstruction of one pair, of gridding and of the writers, and how memory grows.

python -m benchmarks.terrain_speed
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable

import numpy as np

from benchmarks.terrain import rendered
from modules.catalog import operators
from modules.reconstruction.grid_elevation import GridElevationParams, grid_elevation
from modules.types import Attitude, Calibration, Disparity, PointCloud, Scene

STEPS = (
    "level_by_attitude", "triangulate_disparity", "gate_points", "remove_radius_outliers", "grid_elevation",
    "fill_holes", "compute_slope", "trace_sight", "assess_traversability",
)  # fmt: skip
NOISE_PX = 0.1


def cpu_ms(what: Callable[[], object], repeats: int = 5) -> float:
    """Return the least CPU time of several runs, ms."""
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        what()
        spent.append(time.process_time() - start)
    return 1000.0 * min(spent)


def main() -> None:
    made = rendered(100)
    rng = np.random.default_rng(0)
    noisy = made.disparity_px + NOISE_PX * rng.standard_normal(made.disparity_px.shape).astype(np.float32)
    scene = Scene(
        Disparity(noisy, np.isnan(noisy).astype(np.uint16)), made.left, made.calibration, made.attitude, made.mount
    )
    total = 0.0
    for name in STEPS:
        operator = operators()[f"reconstruction.{name}"]
        parameters = operator.params()
        spent = cpu_ms(
            lambda operator=operator, scene=scene, parameters=parameters: operator.function(scene, parameters)
        )
        scene = operator.function(scene, parameters)
        total += spent
        print(f"{name:28s} {spent:8.1f} ms")
    print(f"{'disparity to all products':28s} {total:8.1f} ms (bar 250)")
    _gridding()
    _memory()


def _cloud(count: int) -> Scene:
    rng = np.random.default_rng(1)
    xyz = np.column_stack([rng.uniform(0, 9, count), rng.uniform(-5, 5, count), rng.normal(0, 0.05, count)])
    covariance = np.tile(np.array([1e-3, 0, 0, 1e-3, 0, 1e-3], np.float32), (count, 1))
    points = PointCloud(xyz.astype(np.float32), "level", np.arange(count, dtype=np.int32), covariance_m2=covariance)
    empty = Disparity(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.uint16))
    camera = Calibration(500.0, 320.0, 240.0, 0.09, 640, 480)
    return Scene(empty, np.zeros((1, 1), np.uint8), camera, Attitude(), points=points)


def _gridding() -> None:
    scene = _cloud(300_000)
    grid_elevation(scene, GridElevationParams())
    spent = cpu_ms(lambda: grid_elevation(scene, GridElevationParams()))
    print(f"{'gridding 300,000 points':28s} {spent:8.1f} ms (bar 15)")


def _memory() -> None:
    for count in (100_000, 200_000, 400_000):
        scene = _cloud(count)
        tracemalloc.start()
        grid_elevation(scene, GridElevationParams())
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        print(f"gridding {count} points: peak {peak / 1e6:.1f} MB, {peak / count:.0f} bytes per point")


if __name__ == "__main__":
    main()
