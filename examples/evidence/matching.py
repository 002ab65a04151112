"""Print how window, smoothing and sharpness change the error of the semi-global matcher, per fault of the cameras.

The evidence behind MAT010, MAT013, MAT014, COR020 and COR037: mean bad-1 in % (missing counted as wrong) over every
N-th development pair, left-right check and speckle removal as in the shipped plan.

    TERREX_DATA=FOLDER python examples/evidence/matching.py [--every 4]
"""

from __future__ import annotations

import numpy as np
from development import development_pairs

from modules.catalog import operators
from modules.formats.datasets import DatasetPair
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.types import DisparityRange, Matching, Views

FAULTS: dict[str, tuple[SensorParams, SensorParams]] = {  # of the left and of the right camera
    "clean": (SensorParams(), SensorParams()),
    "noise right 6": (SensorParams(), SensorParams(noise_sigma_dn=6.0)),
    "noise right 12": (SensorParams(), SensorParams(noise_sigma_dn=12.0)),
    "noise both 6": (SensorParams(noise_sigma_dn=6.0), SensorParams(noise_sigma_dn=6.0)),
    "noise both 12": (SensorParams(noise_sigma_dn=12.0), SensorParams(noise_sigma_dn=12.0)),
    "blur right 1.0": (SensorParams(), SensorParams(blur_sigma_px=1.0)),
    "blur right 2.0": (SensorParams(), SensorParams(blur_sigma_px=2.0)),
}
MATCHER = "matching.semi_global_match"
AFTER = ("matching.check_left_right", "matching.remove_speckles")
SMOOTH = ("correction.denoise_gaussian", {"sigma_px": 0.8})
SHARPNESS = ("correction.match_sharpness", {"strength": 0.6})
Step = tuple[str, dict]
CONFIGURATIONS: tuple[tuple[Step | None, dict], ...] = (
    (None, {}),
    (None, {"p1": 6.0, "p2": 40.0}),
    (None, {"window_px": 7}),
    (None, {"window_px": 9}),
    (None, {"window_px": 11}),
    (SMOOTH, {}),
    (SMOOTH, {"window_px": 9}),
    (SHARPNESS, {}),
)


def bad_1(pair: DatasetPair, views: Views, correction: Step | None, values: dict) -> float:
    """Return the error of one configuration on one pair, %."""
    catalog = operators()
    if correction is not None:
        name, params = correction
        views = catalog[name].function(views, catalog[name].params(**params))
    state = Matching(views, DisparityRange(0, pair.ndisp))
    state = catalog[MATCHER].function(state, catalog[MATCHER].params(**values))
    for name in AFTER:
        state = catalog[name].function(state, catalog[name].params())
    error = np.abs(state.disparity.disparity_px - pair.truth_px)[pair.scored]
    return 100.0 * float(np.mean(~(error <= 1.0)))


def main() -> None:
    pairs = development_pairs(__doc__)
    print(f"mean bad-1 in % over {len(pairs)} pairs\n{'':44s}" + "".join(f"{name:>16s}" for name in FAULTS))
    seen = [
        pair.views.with_images(apply_sensor(pair.views.left, left, 5), apply_sensor(pair.views.right, right, 6))
        for pair in pairs
        for left, right in FAULTS.values()
    ]
    for correction, values in CONFIGURATIONS:
        errors = np.array([bad_1(pairs[i // len(FAULTS)], views, correction, values) for i, views in enumerate(seen)])
        named = ", ".join(f"{name} {value:g}" for name, value in values.items()) or "defaults"
        title = f"{correction[0].partition('.')[2] if correction else ''} {named}".strip()
        print(f"{title:44s}" + "".join(f"{e:16.2f}" for e in errors.reshape(len(pairs), -1).mean(axis=0)))


if __name__ == "__main__":
    main()
