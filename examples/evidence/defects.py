"""Print what stuck pixels and lines cost matchers, and whether their repair pays.

The evidence behind COR038. The right image gets hot and dead pixels, and half-bright columns and rows.

    TERREX_DATA=FOLDER python examples/evidence/defects.py [--every 3] [--terrain 2] [--matchers sgbm own block]
"""

from comparison import arguments, compare

DISTORTIONS = {"clean": "clean", "stuck 0.1 %": 0.001, "stuck 1 %": 0.01}
CORRECTIONS = {
    "repair_stuck_pixels": (("correction.repair_stuck_pixels", {}),),
    "repair_stuck_pixels, 20 dn": (("correction.repair_stuck_pixels", {"threshold_dn": 20.0}),),
    "denoise_gaussian, 0.8 px": (("correction.denoise_gaussian", {"sigma_px": 0.8}),),
}

if __name__ == "__main__":
    compare(arguments(__doc__), DISTORTIONS, CORRECTIONS)
