"""Print which correction helps which matcher under noise, and when smoothing begins to pay.

The evidence behind COR020 and COR036.

    TERREX_DATA=FOLDER python examples/evidence/noise.py [--every 3] [--terrain 2] [--matchers sgbm own block]
"""

from comparison import Both, arguments, compare

from modules.simulation.sensor import SensorParams

DISTORTIONS = {
    **{f"noise {sigma}": SensorParams(noise_sigma_dn=sigma) for sigma in (4, 8, 12, 18)},
    **{f"noise {sigma} in both": Both(SensorParams(noise_sigma_dn=sigma)) for sigma in (6, 12, 18)},
}
CORRECTIONS = {
    **{
        f"denoise_gaussian, {sigma} px": (("correction.denoise_gaussian", {"sigma_px": sigma}),)
        for sigma in (0.6, 0.8, 1.0, 1.4)
    },
    "denoise_bilateral": (("correction.denoise_bilateral", {}),),
    "denoise_non_local_means": (("correction.denoise_non_local_means", {"search_radius_px": 5}),),
}

if __name__ == "__main__":
    compare(arguments(__doc__), DISTORTIONS, CORRECTIONS)
