"""Print how the window of the subpixel refinement changes its error, per fault of the cameras.

The evidence behind MAT070 and MAT071: median absolute error in 1/100 px of the pixels that are right within 1 px, over
every N-th development pair, whose surfaces face the camera, and over rendered terrain, which is seen at a flat angle.
There also the median absolute error of means over 8 x 2 px, the size of a cell of 5 cm at 4 m: what noise leaves after
averaging counts in an elevation map. How the elevation itself fares within 6 m is told by `benchmarks.terrain`.

    TERREX_DATA=FOLDER python examples/evidence/refinement.py [--every 4]
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from development import development_pairs
from matching import FAULTS
from numpy.typing import NDArray

from modules.catalog import operators
from modules.simulation.sensor import apply_sensor
from modules.simulation.terrain import TerrainParams, render_terrain
from modules.types import DisparityRange, Image, Matching, Views

MATCHER = "matching.semi_global_match"
SEEDS = (201, 202, 203)
KINDS = ("clean", "noise right 6", "noise right 12", "noise both 12", "blur right 1.0", "blur right 2.0")
WINDOWS = (  # width, height, passes, weight of the misfit
    (5, 5, 1, 5.0),
    (7, 7, 3, 5.0),
    (7, 7, 3, 1.5),
    (13, 5, 3, 5.0),
    (13, 5, 3, 1.5),
    (15, 3, 4, 5.0),
    (15, 3, 4, 1.5),
)
PIXEL, CELL = (1, 1), (2, 8)  # rows and columns
Sample = tuple[Image, Image, int, NDArray[np.float32], NDArray[np.bool_]]  # images, range, truth, what is scored


def terrains() -> Iterator[Sample]:
    for seed in SEEDS:
        made = render_terrain(TerrainParams(seed=seed, roll_deg=4.0, pitch_deg=-5.0))
        scored = np.isfinite(made.disparity_px) & ~made.occluded
        yield made.left, made.right, 80, made.disparity_px, scored


def error_px(sample: Sample, fault: str, window: tuple[int, int, int, float], block: tuple[int, int]) -> float:
    """Return the median absolute error of means over blocks (rows, columns) that are right within 1 px, 1/100 px."""
    left, right, most, truth, scored = sample
    views = Views(apply_sensor(left, FAULTS[fault][0], seed=1), apply_sensor(right, FAULTS[fault][1], seed=2))
    names = ("refine_px", "refine_rows_px", "refine_passes", "refine_misfit")
    params = operators()[MATCHER].params(
        window_px=5 if fault == "clean" else 7, gray="mean", **dict(zip(names, window, strict=True))
    )
    found = operators()[MATCHER].function(Matching(views, DisparityRange(0, most)), params).disparity.disparity_px
    error = np.where(scored & (np.abs(found - truth) <= 1.0), found - truth, np.nan)
    tall, wide = (size // part for size, part in zip(error.shape, block, strict=True))
    blocks = error[: tall * block[0], : wide * block[1]].reshape(tall, block[0], wide, block[1])
    return 100.0 * float(np.nanmedian(np.abs(blocks.mean(axis=(1, 3)))))


def main() -> None:
    facing = [(p.views.left, p.views.right, p.ndisp, p.truth_px, p.scored) for p in development_pairs(__doc__)]
    ground = list(terrains())
    tables = (
        ("development pairs", facing, PIXEL),
        ("rendered terrain", ground, PIXEL),
        ("rendered terrain, cells", ground, CELL),
    )
    for title, samples, block in tables:
        print(f"{title + ', ' + str(len(samples)):44s}" + "".join(f"{kind:>16s}" for kind in KINDS))
        for window in WINDOWS:
            width, height, passes, weight = window
            means = [np.mean([error_px(sample, kind, window, block) for sample in samples]) for kind in KINDS]
            label = f"{width} x {height} px, {passes} passes, misfit x {weight:g}"
            print(f"{label:44s}" + "".join(f"{value:16.2f}" for value in means), flush=True)


if __name__ == "__main__":
    main()
