"""The pipeline of the paper on its rig, with each correction it names, and the expert system beside it.

Correct one image to the other, compute disparities, reproject, turn by the inertial attitude: on rendered terrain with
exact truth, seen by the paper's rig (640x480, baseline 9 cm) whose right camera differs. Does histogram matching win,
where, and where does the expert system beat it? The matcher of the fixed pipelines is OpenCV's semi-global one.

    python examples/paper.py [--seeds 5]

Prints per difference of the cameras and per correction: wrong or missing disparities (bad-1, % of the pixels that both
cameras see) and the median error of the elevation map within 6 m (cm), both as medians over the seeds.
"""

from __future__ import annotations

import argparse

import numpy as np

from expert import ExpertSystem, StereoPair
from modules.catalog import operators
from modules.operator import OperatorError
from modules.simulation import TerrainParams, distort_right, render_terrain
from modules.simulation.terrain import RenderedPair
from modules.types import DisparityRange, ElevationMap, FloatImage, Matching, Scene, Views

NEAR_M = 6.0
ATTITUDE_LIMIT_DEG = 15.0
RANGE = DisparityRange(0, 96)
KINDS = ("clean", "dark", "clipped", "curve", "vignette", "local", "combined")
CORRECTIONS: dict[str, tuple[tuple[str, dict], ...]] = {
    "none": (),
    "histogram matching": (("correction.match_histograms", {"channels": "each"}),),
    "equalization": (("correction.equalize_histogram", {"channels": "each"}),),
    "homomorphic": (("correction.filter_homomorphic", {}),),
    "segment calibration": (("correction.calibrate_segments", {}),),
}
AFTER = (
    ("matching.semi_global_block_match", {}),
    ("matching.check_left_right", {}),
    ("matching.remove_speckles", {}),
)
TERRAIN = (
    ("reconstruction.triangulate_disparity", {}),
    ("reconstruction.level_by_attitude", {}),
    ("reconstruction.gate_points", {}),
    ("reconstruction.grid_elevation", {}),
)


def pipeline(made: RenderedPair, views: Views, steps: tuple[tuple[str, dict], ...]) -> tuple[FloatImage, ElevationMap]:
    """Run the paper's three modules with one correction."""
    catalog = operators()
    for name, values in steps:
        views = catalog[name].function(views, catalog[name].params(**values))
    state = Matching(views, RANGE)
    for name, values in AFTER:
        state = catalog[name].function(state, catalog[name].params(**values))
    assert state.disparity is not None
    scene = Scene(state.disparity, made.left, made.calibration, made.attitude, made.mount)
    for name, values in sorted(TERRAIN, key=lambda step: ORDER.index(catalog[step[0]].slot)):
        scene = catalog[name].function(scene, catalog[name].params(**values))
    assert scene.elevation is not None
    return state.disparity.disparity_px, scene.elevation


ORDER = ("frame", "triangulate", "gate", "grid")


def expert(made: RenderedPair, views: Views, system: ExpertSystem) -> tuple[FloatImage, ElevationMap | None]:
    """Let the expert system decide; it is not told the disparities to search."""
    pair = StereoPair(views.left, views.right, calibration=made.calibration, attitude=made.attitude, mount=made.mount)
    result = system.reconstruct(pair)
    return result.disparity_px, result.elevation


def errors(made: RenderedPair, disparity_px: FloatImage, grid: ElevationMap | None) -> tuple[float, float]:
    """Return bad-1 in % and the median elevation error in cm; NaN without a map."""
    wrong = ~(np.abs(disparity_px - made.disparity_px)[made.nonocc] <= 1.0)
    if grid is None:
        return 100.0 * float(wrong.mean()), float("nan")
    truth = made.true_elevation(grid.x0_m, grid.y0_m, grid.cell_m, grid.shape).layers["elevation"]
    rows, columns = grid.shape
    x = grid.x0_m + (np.arange(columns) + 0.5) * grid.cell_m
    y = grid.y0_m + (np.arange(rows) + 0.5) * grid.cell_m
    near = np.hypot(x[None, :], y[:, None]) <= NEAR_M
    error = np.abs(grid.layers["elevation"] - truth)[near]
    known = np.isfinite(error)
    return 100.0 * float(wrong.mean()), 100.0 * float(np.median(error[known])) if known.any() else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    args = parser.parse_args()
    system = ExpertSystem()
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for seed in range(args.seeds):
        roll, pitch = np.random.default_rng(seed).uniform(-ATTITUDE_LIMIT_DEG, ATTITUDE_LIMIT_DEG, 2)
        made = render_terrain(TerrainParams(seed=seed, roll_deg=float(roll), pitch_deg=float(pitch)))
        for kind in KINDS:
            views = distort_right(Views(made.left, made.right), kind, seed=seed)
            for name, steps in CORRECTIONS.items():
                try:
                    found.setdefault((name, kind), []).append(errors(made, *pipeline(made, views, steps)))
                except OperatorError as error:
                    print(f"seed {seed}, {kind}, {name}: {error}")
            found.setdefault(("expert system", kind), []).append(errors(made, *expert(made, views, system)))
    report(found)


def report(found: dict[tuple[str, str], list[tuple[float, float]]]) -> None:
    """Print a table per measure and what wins."""
    names = [*CORRECTIONS, "expert system"]
    medians = {key: np.nanmedian(np.array(values), axis=0) for key, values in found.items()}
    for index, title in enumerate(("bad-1, %", "median elevation error within 6 m, cm")):
        print(f"\n{title:22s}" + "".join(f"{kind:>10s}" for kind in KINDS))
        for name in names:
            cells = [medians.get((name, kind), (np.nan, np.nan))[index] for kind in KINDS]
            print(f"{name:22s}" + "".join(f"{value:10.2f}" for value in cells))
    print()
    for kind in KINDS:
        fixed = {name: medians[name, kind][0] for name in CORRECTIONS if (name, kind) in medians}
        best = min(fixed, key=lambda name: fixed[name])
        own = medians["expert system", kind][0]
        print(
            f"{kind}: of the corrections {best} is best ({fixed[best]:.2f} %), histogram matching gives "
            f"{fixed['histogram matching']:.2f} %; the expert system {own:.2f} %"
        )


if __name__ == "__main__":
    main()
