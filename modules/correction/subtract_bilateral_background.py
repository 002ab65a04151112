"""Subtract the background that a bilateral filter leaves."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import to_levels
from modules.types import Image, Views, dn_scale


class SubtractBilateralBackgroundParams(OperatorParams):
    """Parameters of `subtract_bilateral_background`."""

    sigma_px: float = Field(3.0, ge=1.0, le=10.0, description="Standard deviation of the window in space, px")
    sigma_dn: float = Field(20.0, ge=2.0, le=100.0, description="Standard deviation of the window in intensity, dn")
    gain: float = Field(2.0, ge=0.5, le=20.0, description="Output DN per DN of the difference, 1")


def subtract_bilateral_background(views: Views, params: SubtractBilateralBackgroundParams) -> Views:
    """Replace both images by their difference from a bilateral mean, with one scaling for both.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : SubtractBilateralBackgroundParams

    Returns
    -------
    Views
        Images of the same shape and dtype: half of full scale plus `gain` times the difference, rounded to nearest and
        clipped; the window reaches twice `sigma_px`. A constant image becomes half of full scale.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    Removes local offsets and keeps strong edges sharp, as the background follows them; not a difference of gain. Takes
    most of its time in the filter, which grows with the window.

    References
    ----------
    A. Ansar, A. Castano, L. Matthies, Enhanced real-time stereo using bilateral filtering, 3DPVT 2004; H. Hirschmueller
    and D. Scharstein, Evaluation of stereo matching costs on images with radiometric differences, IEEE TPAMI 31, 2009.
    """
    check_pair(views, "correction.subtract_bilateral_background")
    return views.with_images(_subtract(views.left, params), _subtract(views.right, params))


def _subtract(image: Image, params: SubtractBilateralBackgroundParams) -> Image:
    values = image.astype(np.float32) if image.dtype == np.uint16 else image
    diameter = 2 * int(np.ceil(2 * params.sigma_px)) + 1
    background = cv2.bilateralFilter(values, diameter, params.sigma_dn * dn_scale(image), params.sigma_px)
    difference = image.astype(np.float32) - background
    return to_levels(np.asarray(difference, np.float32), params.gain, 127.5 * dn_scale(image), image)


OPERATOR = Operator(
    name="correction.subtract_bilateral_background",
    slot="local",
    params=SubtractBilateralBackgroundParams,
    function=subtract_bilateral_background,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=340),
    summary="Replaces both images by their difference from a bilateral mean.",
    suits="Offsets and soft local light with intensity-based costs; harms noisy pairs, useless for census.",
)
