"""Print whether equal sharpness helps matchers when one image is out of focus.

The evidence behind COR037.

    TERREX_DATA=FOLDER python examples/evidence/blur.py [--every 3] [--terrain 2] [--matchers sgbm own block]
"""

from comparison import arguments, compare

from modules.simulation.sensor import SensorParams

DISTORTIONS = {f"blur {sigma}": SensorParams(blur_sigma_px=sigma) for sigma in (0.8, 1.3, 2.0)}
CORRECTIONS = {
    "match_sharpness": (("correction.match_sharpness", {}),),
    "match_sharpness, 0.6": (("correction.match_sharpness", {"strength": 0.6}),),
    "denoise_gaussian, 0.8 px": (("correction.denoise_gaussian", {"sigma_px": 0.8}),),
    "match_histograms": (("correction.match_histograms", {}),),
    "transfer_local_affine": (("correction.transfer_local_affine", {}),),
}

if __name__ == "__main__":
    compare(arguments(__doc__), DISTORTIONS, CORRECTIONS)
