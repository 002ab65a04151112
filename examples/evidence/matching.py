"""Print how penalties, window and smoothing change the error of the semi-global matcher, per distortion.

The evidence behind MAT010, MAT013, MAT014, MAT017 and COR020: mean bad-1 in % (missing counted as wrong) over every
N-th development pair, left-right check, speckle removal and median as in the shipped plan.

    TERREX_DATA=FOLDER python examples/evidence/matching.py [--every 4]
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

from modules.catalog import operators
from modules.formats.datasets import DatasetPair, read_index
from modules.simulation.distortions import distort_right
from modules.types import DisparityRange, Matching, Views

KINDS = ("clean", "dark", "noise", "combined", "blur", "local")
MATCHER = "matching.semi_global_match"
AFTER = ("matching.check_left_right", "matching.remove_speckles", "matching.median_filter")
CONFIGURATIONS: tuple[tuple[float | None, dict], ...] = (
    (None, {"p1": 6.0, "p2": 40.0, "window_px": 5}),
    (None, {"p1": 12.0, "p2": 70.0, "window_px": 5}),
    (None, {"p1": 20.0, "p2": 120.0, "window_px": 5}),
    (None, {"p1": 12.0, "p2": 70.0, "window_px": 9}),
    (0.8, {"p1": 12.0, "p2": 70.0, "window_px": 5}),
    (0.8, {"p1": 12.0, "p2": 80.0, "window_px": 9}),
    (1.5, {"p1": 12.0, "p2": 80.0, "window_px": 9}),
)


def bad_1(pair: DatasetPair, views: Views, sigma_px: float | None, values: dict) -> float:
    """Return the error of one configuration on one pair, %."""
    catalog = operators()
    if sigma_px is not None:
        denoise = catalog["correction.denoise_gaussian"]
        views = denoise.function(views, denoise.params(sigma_px=sigma_px))
    state = Matching(views, DisparityRange(0, pair.ndisp))
    state = catalog[MATCHER].function(state, catalog[MATCHER].params(**values))
    for name in AFTER:
        state = catalog[name].function(state, catalog[name].params())
    error = np.abs(state.disparity.disparity_px - pair.truth_px)[pair.scored]
    return 100.0 * float(np.mean(~(error <= 1.0)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"))
    parser.add_argument("--every", type=int, default=4)
    args = parser.parse_args()
    if not args.data:
        raise SystemExit("no data: set TERREX_DATA or give --data FOLDER")
    pairs = list(read_index(Path(args.data), "dev"))[:: args.every]
    print(
        f"mean bad-1 in % over {len(pairs)} pairs\n{'smoothing':>10s} {'matcher':38s}"
        + "".join(f"{k:>10s}" for k in KINDS)
    )
    for sigma_px, values in CONFIGURATIONS:
        errors = [
            np.mean([bad_1(pair, distort_right(pair.views, kind, seed=5), sigma_px, values) for pair in pairs])
            for kind in KINDS
        ]
        named = ", ".join(f"{name} {value:g}" for name, value in values.items())
        print(f"{sigma_px or 'none':>10} {named:38s}" + "".join(f"{error:10.2f}" for error in errors))


if __name__ == "__main__":
    main()
