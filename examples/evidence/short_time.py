"""Print what the parts of a plan gain and what they cost.

The evidence behind MEA081, MAT080, MAT081 and MAT086: mean bad-1 and bad-0.5 (missing counted as wrong), wrong among
valid and density in %, and CPU time of one thread relative to the own matcher with its usual checks (least of three
runs), over every N-th development pair under four distortions of the right image.

    TERREX_DATA=FOLDER python examples/evidence/short_time.py [--every 4]
"""

from __future__ import annotations

import time

import cv2
import numpy as np
from development import development_pairs

from modules.catalog import operators
from modules.formats.datasets import DatasetPair
from modules.simulation.distortions import distort_right
from modules.types import DisparityRange, FloatImage, Matching, Views

KINDS = ("clean", "dark", "local", "noise")
REPEATS = 3  # the least of so many times counts
Step = tuple[str, dict]
OWN, CHECKS = "matching.semi_global_match", [("matching.check_left_right", {}), ("matching.remove_speckles", {})]
CONFIDENCE = ("matching.estimate_confidence", {"least": 0.2})
HISTOGRAM = ("correction.match_histograms", {"slope_limit": 1.5})
WAYS: dict[str, list[Step]] = {
    "own matcher": [(OWN, {}), *CHECKS],
    "after histogram matching": [HISTOGRAM, (OWN, {}), *CHECKS],
    "four paths": [(OWN, {"paths": 4}), *CHECKS],
    "equiangular": [(OWN, {"subpixel": "equiangular"}), *CHECKS],
    "equiangular, four paths": [(OWN, {"subpixel": "equiangular", "paths": 4}), *CHECKS],
    "and confidence": [(OWN, {}), *CHECKS, CONFIDENCE],
    "and median, confidence": [(OWN, {}), *CHECKS, ("matching.median_filter", {}), CONFIDENCE],
    "confidence kept, islands": [
        (OWN, {}),
        CHECKS[0],
        ("matching.remove_speckles", {"max_size_px": 30}),
        ("matching.median_filter", {}),
        ("matching.estimate_confidence", {"least": 0.0}),
    ],
    "OpenCV's matcher": [("matching.semi_global_block_match", {}), *CHECKS],
    "block matching": [("matching.block_match", {}), *CHECKS],
}


def run(views: Views, ndisp: int, steps: list[Step]) -> tuple[FloatImage, float]:
    """Return the disparity and the CPU time, s."""
    catalog = operators()
    begun = time.process_time()
    state = Matching(views, DisparityRange(0, ndisp))
    for name, values in steps:
        operator = catalog[name]
        params = operator.params(**values)
        if operator.stage == "correction":
            state = Matching(operator.function(state.views, params), state.range_px)
        else:
            state = operator.function(state, params)
    return state.disparity.disparity_px, time.process_time() - begun


def figures(pair: DatasetPair, views: Views, steps: list[Step]) -> tuple[float, ...]:
    """Return bad-1, bad-0.5, wrong among valid and density in %, and CPU time, s."""
    disparity, seconds = run(views, pair.ndisp, steps)
    seconds = min(seconds, *(run(views, pair.ndisp, steps)[1] for _ in range(REPEATS - 1)))
    error = np.abs(disparity - pair.truth_px)[pair.scored]
    valid = np.isfinite(error)
    wrong = float(np.mean(error[valid] > 1.0)) if valid.any() else 0.0
    shares = (1 - np.mean(error <= 1.0), 1 - np.mean(error <= 0.5), wrong, np.mean(valid))
    return (*(100.0 * float(share) for share in shares), seconds)


def main() -> None:
    pairs = development_pairs(__doc__)
    cv2.setNumThreads(1)
    cases = [(pair, distort_right(pair.views, kind, number)) for number, pair in enumerate(pairs) for kind in KINDS]
    for steps in WAYS.values():
        run(cases[0][1], pairs[0].ndisp, steps)  # what is compiled and loaded once does not count
    found = {name: np.mean([figures(*case, steps) for case in cases], axis=0) for name, steps in WAYS.items()}
    print(f"means over {len(pairs)} pairs, {', '.join(KINDS)}")
    print(f"{'':26s}{'bad-1':>8s}{'bad-0.5':>9s}{'wrong':>8s}{'density':>9s}{'CPU':>7s}")
    for name, (bad_1, bad_05, wrong, density, seconds) in found.items():
        relative = seconds / found["own matcher"][-1]
        print(f"{name:26s}{bad_1:8.2f}{bad_05:9.2f}{wrong:8.2f}{density:9.1f}{relative:7.2f}")


if __name__ == "__main__":
    main()
