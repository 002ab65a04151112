"""Print what windows that shift and penalties that follow the edges of the left image change, by its noise.

The evidence behind MAT018 and the defaults of `matching.semi_global_match`: bad-1 (missing counted as wrong) and wrong
among valid in % over every N-th development pair, left-right check and speckle removal as in the shipped plan.

    TERREX_DATA=FOLDER python examples/evidence/edges.py [--every 4]
"""

from __future__ import annotations

import numpy as np
from development import development_pairs

from modules.catalog import operators
from modules.formats.datasets import DatasetPair
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.types import DisparityRange, Matching, Views

NOISE_DN = {"quiet": (0.0, 0.0), "left 4": (4.0, 0.0), "left 9": (9.0, 0.0), "both 4": (4.0, 4.0), "both 9": (9.0, 9.0)}
FROM_DN = 4.5  # noise from which the window is wider, `noise_dn` of MAT013
STEPS = ("matching.semi_global_match", "matching.check_left_right", "matching.remove_speckles")
CONFIGURATIONS = {
    "windows in place, P1 everywhere": {"shift_px": 0, "p1_decay_per_dn": 0.0},
    "windows in place": {"shift_px": 0},
    "penalties fall slowly": {"p1_decay_per_dn": 0.05, "p2_decay_per_dn": 0.05},
    "defaults": {},
    "penalties fall faster": {"p1_decay_per_dn": 0.1, "p2_decay_per_dn": 0.2, "p2": 120.0},
    "as MAT018 in a quiet image": {"p1_decay_per_dn": 0.1, "p2_decay_per_dn": 0.4, "p2": 120.0},
}


def errors(pair: DatasetPair, views: Views, values: dict) -> tuple[float, float]:
    """Return bad-1 and wrong among valid, %."""
    state = Matching(views, DisparityRange(0, pair.ndisp))
    for name in STEPS:
        operator = operators()[name]
        state = operator.function(state, operator.params(**(values if name == STEPS[0] else {})))
    error = np.abs(state.disparity.disparity_px - pair.truth_px)[pair.scored]
    valid = np.isfinite(error)
    return 100.0 * float(np.mean(~(error <= 1.0))), 100.0 * float(np.mean(error[valid] > 1.0)) if valid.any() else 0.0


def main() -> None:
    pairs = development_pairs(__doc__)
    print(f"means over {len(pairs)} pairs, bad-1 / wrong\n{'noise, dn':34s}" + "".join(f"{n:>15s}" for n in NOISE_DN))
    for title, values in CONFIGURATIONS.items():
        cells = []
        for noise in NOISE_DN.values():
            wide = {"window_px": 7, "gray": "mean"} if max(noise) >= FROM_DN else {}
            left, right = (SensorParams(noise_sigma_dn=sigma) for sigma in noise)
            seen = [
                (p, p.views.with_images(apply_sensor(p.views.left, left, 5), apply_sensor(p.views.right, right, 6)))
                for p in pairs
            ]
            bad, wrong = np.mean([errors(pair, views, {**wide, **values}) for pair, views in seen], axis=0)
            cells.append(f"{bad:7.2f} / {wrong:.2f}".rjust(15))
        print(f"{title:34s}" + "".join(cells))


if __name__ == "__main__":
    main()
