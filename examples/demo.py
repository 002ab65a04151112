"""Run the main job three times: on a real pair, on the same pair degraded, and on a rendered terrain.

Run it with `make demo`. Results are written to demo-out/.
"""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
from motorcycle import default_cache, not_occluded, obtain_motorcycle, true_disparity
from numpy.typing import NDArray

from expert import ExpertSystem, StereoPair
from expert.api import Result
from modules.simulation.terrain import RenderedPair, TerrainParams, render_terrain

OUT = Path("demo-out")
BAD_PX = 2.0
ELEVATION_RANGE_M = 6.0
DARK_GAIN, DARK_GAMMA, DARK_NOISE_DN = 0.45, 1.3, 1.5


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
    left, right = read_rgb(folder / "left.png"), read_rgb(folder / "right.png")
    about = "Motorcycle (Middlebury 2014), as it is"
    if degraded:
        right = degrade(right)
        about = f"Motorcycle, right image degraded: {DEGRADATION}"
    truth = true_disparity(folder)
    result = run(system, name, about, StereoPair(left, right, calibration=folder / "calib.txt"))
    print_disparity_error(result, truth, not_occluded(truth))


def demonstrate_rendered_pair(
    system: ExpertSystem, name: str, roll_deg: float, pitch_deg: float, degraded: bool = False
) -> None:
    rendered = render_terrain(TerrainParams(seed=1, roll_deg=roll_deg, pitch_deg=pitch_deg))
    about = f"Rendered terrain, rover at roll {roll_deg:g} and pitch {pitch_deg:g} degrees"
    right = degrade(rendered.right) if degraded else rendered.right
    if degraded:
        about += f", right image degraded: {DEGRADATION}"
    pair = StereoPair(
        rendered.left,
        right,
        calibration=rendered.calibration,
        attitude=rendered.attitude,
        mount=rendered.mount,
    )
    result = run(system, name, about, pair)
    print_disparity_error(result, rendered.disparity_px, rendered.nonocc)
    print_elevation_error(result, rendered)


DEGRADATION = f"gain {DARK_GAIN}, gamma {DARK_GAMMA}, noise {DARK_NOISE_DN} DN"


def degrade(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return what a darker camera with a curved response and noise would have seen."""
    noise = np.random.default_rng(1).normal(0.0, DARK_NOISE_DN, image.shape)
    seen = DARK_GAIN * 255.0 * (image / 255.0) ** DARK_GAMMA + noise
    return np.clip(np.rint(seen), 0, 255).astype(np.uint8)


def run(system: ExpertSystem, name: str, about: str, pair: StereoPair) -> Result:
    """Reconstruct a pair, print the decision, and write the results."""
    print(f"\n{'=' * 100}\n{about}\n{'=' * 100}", flush=True)
    start = time.perf_counter()
    result = system.reconstruct(pair)
    seconds = time.perf_counter() - start
    result.save(OUT / name)
    print(result.decision.text())
    print(f"\nTime: {seconds:.1f} s. Files: {OUT / name}/")
    return result


def print_disparity_error(result: Result, truth_px: NDArray[np.float32], scored: NDArray[np.bool_]) -> None:
    """Print bad-2 over the non-occluded pixels, a missing pixel counted as wrong."""
    if result.disparity_px is None:
        print("Disparity: none was computed.")
        return
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


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """Read an 8-bit image as RGB."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise SystemExit(f"{path} cannot be read; delete its folder and run the demo again")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


if __name__ == "__main__":
    main()
