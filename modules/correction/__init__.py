"""Joint correction of the images of a pair."""

from modules.correction import (
    align_rows,
    denoise_gaussian,
    fit_gain_offset,
    mask_saturated,
    mask_sky,
    match_histograms,
    normalise_local_contrast,
)
from modules.operator import Operator

SLOTS: tuple[str, ...] = ("align", "defects", "denoise", "radiometry", "local", "masks")

OPERATORS: tuple[Operator, ...] = (
    align_rows.OPERATOR,
    denoise_gaussian.OPERATOR,
    match_histograms.OPERATOR,
    fit_gain_offset.OPERATOR,
    normalise_local_contrast.OPERATOR,
    mask_saturated.OPERATOR,
    mask_sky.OPERATOR,
)
