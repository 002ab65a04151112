"""Joint correction of the images of a pair."""

from modules.correction import (
    align_rows,
    balance_white,
    denoise_bilateral,
    denoise_gaussian,
    denoise_non_local_means,
    equalize_adaptively,
    equalize_histogram,
    filter_homomorphic,
    filter_laplacian,
    fit_gain_offset,
    mask_featureless,
    mask_saturated,
    mask_sky,
    match_histograms,
    normalise_local_contrast,
    rank_locally,
    repair_stuck_pixels,
    subtract_bilateral_background,
    warp_histograms_dynamically,
)
from modules.operator import Operator

SLOTS: tuple[str, ...] = ("align", "defects", "denoise", "radiometry", "local", "masks")

OPERATORS: tuple[Operator, ...] = (
    align_rows.OPERATOR,
    repair_stuck_pixels.OPERATOR,
    denoise_gaussian.OPERATOR,
    denoise_bilateral.OPERATOR,
    denoise_non_local_means.OPERATOR,
    match_histograms.OPERATOR,
    fit_gain_offset.OPERATOR,
    warp_histograms_dynamically.OPERATOR,
    equalize_histogram.OPERATOR,
    balance_white.OPERATOR,
    normalise_local_contrast.OPERATOR,
    filter_homomorphic.OPERATOR,
    filter_laplacian.OPERATOR,
    subtract_bilateral_background.OPERATOR,
    rank_locally.OPERATOR,
    equalize_adaptively.OPERATOR,
    mask_saturated.OPERATOR,
    mask_featureless.OPERATOR,
    mask_sky.OPERATOR,
)
