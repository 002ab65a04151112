"""Average similar patches of each image."""

from __future__ import annotations

from typing import Any, cast

import cv2
import numpy as np
from pydantic import Field

from modules.correction._shared import check_pair, planes_of
from modules.operator import Cost, Operator, OperatorParams
from modules.types import Image, Views, dn_scale


class DenoiseNonLocalMeansParams(OperatorParams):
    """Parameters of `denoise_non_local_means`."""

    strength_dn: float = Field(
        10.0, ge=0.5, le=80.0, description="Difference of patches that still counts as noise, dn"
    )
    patch_radius_px: int = Field(2, ge=1, le=4, description="Pixels from the centre of a patch to its side, px")
    search_radius_px: int = Field(7, ge=2, le=15, description="Pixels from the centre of the search to its side, px")


def denoise_non_local_means(views: Views, params: DenoiseNonLocalMeansParams) -> Views:
    """Replace every pixel of both images by the mean of pixels with similar surroundings.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; channels are compared together at 8 bit, each by itself at 16 bit.
    params : DenoiseNonLocalMeansParams

    Returns
    -------
    Views
        Images of the same shape and dtype, rounded as OpenCV does.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    By far the slowest operator of the stage, about 0.5 s for a small pair; flattens texture near the noise level, which
    costs matches on clean pairs. 16-bit images are compared by absolute, 8-bit ones by squared differences.

    References
    ----------
    A. Buades, B. Coll, J.-M. Morel, A non-local algorithm for image denoising, CVPR 2005.
    """
    check_pair(views, "correction.denoise_non_local_means")
    return views.with_images(_average(views.left, params), _average(views.right, params))


def _average(image: Image, params: DenoiseNonLocalMeansParams) -> Image:
    patch, search = 2 * params.patch_radius_px + 1, 2 * params.search_radius_px + 1
    if image.dtype == np.uint8:
        return np.asarray(cv2.fastNlMeansDenoising(image, None, params.strength_dn, patch, search), np.uint8)
    strength = [params.strength_dn * dn_scale(image)]
    done: list[Any] = [
        cv2.fastNlMeansDenoising(plane, strength, None, patch, search, cv2.NORM_L1) for plane in planes_of(image)
    ]
    return cast(Image, np.stack(done, axis=-1).reshape(image.shape))


OPERATOR = Operator(
    name="correction.denoise_non_local_means",
    slot="denoise",
    params=DenoiseNonLocalMeansParams,
    function=denoise_non_local_means,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=2100),
    summary="Averages pixels with similar surroundings in both images.",
    suits="Strong noise where time is of no concern; costs weak texture and harms clean pairs.",
)
