"""Print which correction helps which matcher under vignetting, a lighting gradient and local light.

The evidence behind COR014, COR015 and COR033 to COR036 and COR039.

    TERREX_DATA=FOLDER python examples/evidence/uneven_light.py [--every 3] [--terrain 2] [--matchers sgbm own block]
"""

from comparison import arguments, compare

from modules.simulation.sensor import SensorParams

DISTORTIONS = {
    "vignette": "vignette",
    "vignette x0.5": "vignette x0.5",
    # The flank of a wide spot is the simulator's nearest thing to a gradient.
    "gradient": SensorParams(spot_gain=1.8, spot_x=-0.2, spot_y=0.5, spot_sigma=0.6),
    "local": "local",
    "local x0.5": "local x0.5",
    "soft spot": SensorParams(spot_gain=1.8),
    "vignetting, curve and cast": SensorParams(vignetting=0.4, gamma=(0.9, 1.2, 1.5), cast=(1.1, 1.0, 0.9)),
    "combined": "combined",
}
MATCH = ("correction.match_histograms", {})
TRANSFER = ("correction.transfer_local_affine", {})
CORRECTIONS = {
    "match_histograms": (MATCH,),
    "transfer_local_affine": (TRANSFER,),
    "transfer_local_affine, radius 0.03": (("correction.transfer_local_affine", {"radius_fraction": 0.03}),),
    "transfer_local_affine, radius 0.1": (("correction.transfer_local_affine", {"radius_fraction": 0.1}),),
    "match_histograms, transfer_local_affine": (MATCH, TRANSFER),
    "level_gain_field, radial": (("correction.level_gain_field", {}),),
    "level_gain_field, plane": (("correction.level_gain_field", {"shape": "plane"}),),
    "level_gain_field, quadratic": (("correction.level_gain_field", {"shape": "quadratic"}),),
    "match_histograms, level_gain_field": (MATCH, ("correction.level_gain_field", {"shape": "quadratic"})),
    "fit_response, level_gain_field, radial": (("correction.fit_response", {}), ("correction.level_gain_field", {})),
    "normalise_local_contrast": (("correction.normalise_local_contrast", {}),),
    "filter_homomorphic": (("correction.filter_homomorphic", {}),),
    "filter_homomorphic, butterworth": (("correction.filter_homomorphic", {"kind": "butterworth"}),),
    "filter_laplacian": (("correction.filter_laplacian", {}),),
    "rank_locally": (("correction.rank_locally", {}),),
    "subtract_bilateral_background": (("correction.subtract_bilateral_background", {}),),
    "equalize_adaptively": (("correction.equalize_adaptively", {}),),
}

if __name__ == "__main__":
    compare(arguments(__doc__), DISTORTIONS, CORRECTIONS)
