"""Whether the ground plane fit states its uncertainty honestly: rendered terrain, no attitude given.

    python -m benchmarks.ground_plane [--seeds 20]

Two yardsticks. The tilt of the level frame against gravity, in predicted sigmas; and the elevation map after the one
that gravity would give, as median absolute error within 6 m. An honest sigma holds 63 % of two-dimensional tilt errors
within sqrt(2) sigma and 98 % within 2 sqrt(2) (Rayleigh).
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

import numpy as np

from modules.primitives.frames import level_from_body
from modules.reconstruction.level_by_ground_plane import LevelByGroundPlaneParams, level_by_ground_plane
from modules.simulation import TerrainParams, render_terrain
from modules.types import Disparity, Scene

ATTITUDE_DEG = 12.0
NOISE_PX = 0.25


def levelled(seed: int) -> tuple[float, float, float, float]:
    """Return tilt error, its predicted sigma per axis, the jackknife alone (deg) and the error of the height (m)."""
    rng = np.random.default_rng(seed)
    roll, pitch = rng.uniform(-ATTITUDE_DEG, ATTITUDE_DEG, 2)
    made = render_terrain(TerrainParams(seed=seed, roll_deg=float(roll), pitch_deg=float(pitch)))
    noisy = made.disparity_px + rng.normal(0, NOISE_PX, made.disparity_px.shape)
    seen = np.where(made.nonocc, noisy, np.nan).astype(np.float32)
    disparity = Disparity(seen, np.isnan(seen).astype(np.uint16))
    scene = Scene(disparity, made.left, made.calibration, mount=made.mount)
    done = level_by_ground_plane(scene, LevelByGroundPlaneParams())
    if done.attitude is None or done.ground is None:
        raise RuntimeError("level_by_ground_plane gave no attitude")
    up = level_from_body(replace(made.attitude, yaw_rad=0.0)).T @ [0.0, 0.0, 1.0]
    found = level_from_body(done.attitude).T @ [0.0, 0.0, 1.0]
    error = math.degrees(math.acos(min(1.0, float(up @ found))))
    return error, math.degrees(done.attitude.sigma_rad), math.degrees(done.ground.sigma_tilt_rad), done.ground.height_m


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    args = parser.parse_args()
    rows = np.array([levelled(seed) for seed in range(300, 300 + args.seeds)])
    print(f"{'seed':>6s} {'tilt error':>11s} {'sigma':>7s} {'fit alone':>10s} {'height m':>9s}   deg")
    for seed, (error, sigma, alone, height) in zip(range(300, 300 + args.seeds), rows, strict=True):
        print(f"{seed:6d} {error:11.2f} {sigma:7.2f} {alone:10.2f} {height:9.3f}")
    ratio = rows[:, 0] / rows[:, 1]
    print(f"root mean square of error / (sqrt(2) sigma): {math.sqrt(float(np.mean(ratio**2)) / 2):.2f} (1 is honest)")
    print(f"within sqrt(2) sigma {np.mean(ratio <= math.sqrt(2)):.0%} (63 %), within 2 sqrt(2) sigma "
          f"{np.mean(ratio <= 2 * math.sqrt(2)):.0%} (98 %)")  # fmt: skip


if __name__ == "__main__":
    main()
