"""Print what matching coarsely first costs and saves, by the number of disparities searched.

The evidence behind MAT051: development pairs at twice their size, searched over once, twice and four times the range
that the data set states; bad-1 in px of the original size (missing counted as wrong, %), and CPU time of one thread.

    TERREX_DATA=FOLDER python examples/evidence/wide_range.py [--every 4]
"""

from __future__ import annotations

import time

import cv2
import numpy as np
from development import development_pairs

from modules.catalog import operators
from modules.formats.datasets import DatasetPair
from modules.types import DisparityRange, FloatImage, Image, Matching, Views

STEPS = ("matching.semi_global_match", "matching.check_left_right", "matching.remove_speckles")
EDGES = (0, 160, 256, 400, 10000)  # classes of the number of disparities


def twice(image: Image) -> Image:
    """Return an image of twice the size."""
    return np.asarray(cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC))


def match(views: Views, count: int, coarse_to_fine: bool) -> tuple[FloatImage, float]:
    """Return the disparities, px, and the CPU time, s."""
    catalog = operators()
    state = Matching(views, DisparityRange(0, count))
    start = time.process_time()
    for name in STEPS:
        values = {"coarse_to_fine": coarse_to_fine, "threads": 1} if name == STEPS[0] else {}
        state = catalog[name].function(state, catalog[name].params(**values))
    assert state.disparity is not None
    return state.disparity.disparity_px, time.process_time() - start


def bad_1(disparity: FloatImage, pair: DatasetPair) -> float:
    """Return the error at twice the size in px of the original one, %."""
    assert pair.truth_px is not None
    assert pair.scored is not None
    error = np.abs(disparity[::2, ::2] / 2 - pair.truth_px)[pair.scored]
    return 100.0 * float(np.mean(~(error <= 1.0)))


def main() -> None:
    cv2.setNumThreads(1)
    found: dict[int, list[tuple[float, float, float, float]]] = {}
    for pair in development_pairs(__doc__):
        views = Views(twice(pair.views.left), twice(pair.views.right))
        for factor in (1, 2, 4):
            count = 2 * pair.ndisp * factor
            if 2 * count > views.shape[1]:
                continue
            at_once, slow = match(views, count, coarse_to_fine=False)
            by_tiles, quick = match(views, count, coarse_to_fine=True)
            place = int(np.digitize(count, EDGES)) - 1
            found.setdefault(place, []).append((bad_1(at_once, pair), bad_1(by_tiles, pair), slow, quick))
    print(
        f"{'disparities':>14s} {'runs':>5s} {'bad-1 at once':>14s} {'coarse first':>13s} {'time / time at once':>20s}"
    )
    for place, rows in sorted(found.items()):
        once, tiles, slow, quick = np.mean(rows, axis=0)
        label = f"{EDGES[place]} to {EDGES[place + 1]}"
        print(f"{label:>14s} {len(rows):5d} {once:14.2f} {tiles:13.2f} {quick / slow:20.2f}")


if __name__ == "__main__":
    main()
