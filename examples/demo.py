"""Run the main job three times: on a real pair, on the same pair degraded, and on a rendered terrain.

Run it with `make demo`. Results are written to demo-out/.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from motorcycle import default_cache, not_occluded, obtain_motorcycle, true_disparity
from numpy.typing import NDArray

from expert import ExpertSystem, StereoPair
from expert.result import Result
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.simulation.terrain import RenderedPair, TerrainParams, render_terrain

OUT = Path("demo-out")
BAD_PX = 2.0
ELEVATION_RANGE_M = 6.0
FAULTS = SensorParams(gain=0.45, gamma=(1.3, 1.3, 1.3), noise_sigma_dn=1.5)
DEGRADED = f"right image degraded by gain {FAULTS.gain}, gamma {FAULTS.gamma[1]}, noise {FAULTS.noise_sigma_dn} DN"


def main() -> None:
    system = ExpertSystem()
    folder = obtain_motorcycle(default_cache())
    if folder is None:
        print("Going on with rendered pairs only.")
        demonstrate_rendered_pair(system, "1-rendered", roll_deg=0.0, pitch_deg=0.0)
        demonstrate_rendered_pair(system, "2-rendered-degraded", roll_deg=0.0, pitch_deg=0.0, degraded=True)
    else:
        demonstrate_real_pair(system, "1-motorcycle", folder)
        demonstrate_real_pair(system, "2-motorcycle-degraded", folder, degraded=True)
    demonstrate_rendered_pair(system, "3-terrain", roll_deg=5.0, pitch_deg=-8.0)


def demonstrate_real_pair(system: ExpertSystem, name: str, folder: Path, degraded: bool = False) -> None:
    pair = StereoPair.load(folder / "left.png", folder / "right.png", calibration=folder / "calib.txt")
    truth = true_disparity(folder)
    result = run(system, name, "Motorcycle (Middlebury 2014)", pair, degraded)
    print_disparity_error(result, truth, not_occluded(truth))


def demonstrate_rendered_pair(
    system: ExpertSystem, name: str, roll_deg: float, pitch_deg: float, degraded: bool = False
) -> None:
    rendered = render_terrain(TerrainParams(seed=1, roll_deg=roll_deg, pitch_deg=pitch_deg))
    pair = StereoPair(
        rendered.left,
        rendered.right,
        calibration=rendered.calibration,
        attitude=rendered.attitude,
        mount=rendered.mount,
    )
    about = f"Rendered terrain, rover at roll {roll_deg:g} and pitch {pitch_deg:g} degrees"
    result = run(system, name, about, pair, degraded)
    print_disparity_error(result, rendered.disparity_px, rendered.nonocc)
    print_elevation_error(result, rendered)


def run(system: ExpertSystem, name: str, about: str, pair: StereoPair, degraded: bool) -> Result:
    """Reconstruct a pair, print the decision, and write the results."""
    pair = replace(pair, name=name, right=apply_sensor(pair.right, FAULTS, seed=1) if degraded else pair.right)
    print(f"\n{'=' * 100}\n{about}, {DEGRADED if degraded else 'as it is'}\n{'=' * 100}", flush=True)
    start = time.perf_counter()
    result = system.reconstruct(pair)
    seconds = time.perf_counter() - start
    result.save(OUT / name)
    print(result.decision.text())
    print(f"Time: {seconds:.1f} s. Files: {OUT / name}/")
    return result


def print_disparity_error(result: Result, truth_px: NDArray[np.float32], scored: NDArray[np.bool_]) -> None:
    """Print bad-2 over the non-occluded pixels, a missing pixel counted as wrong."""
    error = np.abs(result.disparity_px - truth_px)[scored]
    found = np.isfinite(error)
    wrong = 1.0 - np.mean(error[found] <= BAD_PX) if found.any() else 1.0
    bad = 1.0 - np.count_nonzero(error[found] <= BAD_PX) / error.size
    print(
        f"Against the truth: bad-2 {100 * bad:.1f} % of the non-occluded pixels, missing ones counted as wrong "
        f"({100 * wrong:.1f} % of those found; {100 * found.mean():.0f} % found)"
    )


def print_elevation_error(result: Result, rendered: RenderedPair) -> None:
    """Print the error of the elevation map in the cells within reach that the left camera sees."""
    found = result.elevation
    if found is None:
        print("Elevation: no map was made.")
        return
    truth = rendered.true_elevation(found.x0_m, found.y0_m, found.cell_m, found.shape)
    rows, columns = np.indices(found.shape)
    x = found.x0_m + (columns + 0.5) * found.cell_m
    y = found.y0_m + (rows + 0.5) * found.cell_m
    error = np.abs(found.layers["elevation"] - truth.layers["elevation"]).astype(np.float64)
    error = error[(np.hypot(x, y) <= ELEVATION_RANGE_M) & np.isfinite(error)]
    if not error.size:
        print(f"Elevation: no cell within {ELEVATION_RANGE_M:g} m that the truth knows.")
        return
    print(
        f"Elevation within {ELEVATION_RANGE_M:g} m ({found.cell_m * 100:g} cm cells): median error "
        f"{100 * np.median(error):.1f} cm, 90 % below {100 * np.quantile(error, 0.9):.1f} cm, {error.size} cells"
    )


if __name__ == "__main__":
    main()
