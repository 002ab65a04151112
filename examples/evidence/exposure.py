"""Print which correction helps which matcher when exposure, response or colour differ.

The evidence behind COR010 to COR013, COR016 and COR031.

    TERREX_DATA=FOLDER python examples/evidence/exposure.py [--every 3] [--terrain 2] [--matchers sgbm own block]
"""

from comparison import arguments, compare

from modules.simulation.sensor import SensorParams

DISTORTIONS = {
    "clean": "clean",
    "dark": "dark",
    "dark x0.4": "dark x0.4",
    "gain 1.3": SensorParams(gain=1.3),
    "offset 20": SensorParams(offset_dn=20),
    "clipped": "clipped",
    "curve": "curve",
    "gamma 1.5": SensorParams(gamma=(1.5, 1.5, 1.5)),
    "cast": SensorParams(cast=(0.85, 1.0, 1.15)),
}
MATCH = "correction.match_histograms"
CORRECTIONS = {
    "match_histograms": ((MATCH, {}),),
    "match_histograms, slope 1.5": ((MATCH, {"slope_limit": 1.5}),),
    "match_histograms, right": ((MATCH, {"reference": "right"}),),
    "match_histograms, right, slope 1.5": ((MATCH, {"reference": "right", "slope_limit": 1.5}),),
    "match_histograms, midway": ((MATCH, {"reference": "midway"}),),
    "match_histograms, gray": ((MATCH, {"channels": "gray"}),),
    "fit_gain_offset": (("correction.fit_gain_offset", {}),),
    "fit_gain_offset, right": (("correction.fit_gain_offset", {"reference": "right"}),),
    "fit_response": (("correction.fit_response", {}),),
    "fit_response, gain": (("correction.fit_response", {"model": "gain"}),),
    "calibrate_segments": (("correction.calibrate_segments", {}),),
    "warp_histograms_dynamically": (("correction.warp_histograms_dynamically", {}),),
    "equalize_histogram": (("correction.equalize_histogram", {}),),
    "balance_white": (("correction.balance_white", {}),),
    "transfer_local_affine": (("correction.transfer_local_affine", {}),),
}

if __name__ == "__main__":
    compare(arguments(__doc__), DISTORTIONS, CORRECTIONS)
