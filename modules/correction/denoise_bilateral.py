"""Smooth both images within surfaces."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import to_levels
from modules.types import Image, Views, dn_scale


class DenoiseBilateralParams(OperatorParams):
    """Parameters of `denoise_bilateral`."""

    sigma_px: float = Field(1.5, ge=0.5, le=5.0, description="Standard deviation of the window in space, px")
    sigma_dn: float = Field(30.0, ge=2.0, le=150.0, description="Standard deviation of the window in intensity, dn")


def denoise_bilateral(views: Views, params: DenoiseBilateralParams) -> Views:
    """Smooth both images by one bilateral filter, which keeps edges higher than the noise.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; colours are compared together.
    params : DenoiseBilateralParams

    Returns
    -------
    Views
        Images of the same shape and dtype, rounded to nearest; the window reaches twice `sigma_px`.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    `sigma_dn` of two to three times the noise smooths it away; weaker texture goes along.

    References
    ----------
    C. Tomasi and R. Manduchi, Bilateral filtering for gray and color images, ICCV 1998.
    """
    check_pair(views, "correction.denoise_bilateral")
    return views.with_images(_smooth(views.left, params), _smooth(views.right, params))


def _smooth(image: Image, params: DenoiseBilateralParams) -> Image:
    diameter = 2 * int(np.ceil(2 * params.sigma_px)) + 1
    values = image.astype(np.float32) if image.dtype == np.uint16 else image
    filtered = cv2.bilateralFilter(values, diameter, params.sigma_dn * dn_scale(image), params.sigma_px)
    if image.dtype == np.uint8:
        return np.asarray(filtered, dtype=np.uint8)
    return to_levels(np.asarray(filtered, dtype=np.float32), 1.0, 0.0, image)


OPERATOR = Operator(
    name="correction.denoise_bilateral",
    slot="denoise",
    params=DenoiseBilateralParams,
    function=denoise_bilateral,
    cost=Cost(fixed_ms=0.5, ns_per_pixel=90),
    summary="Smooths both images by a bilateral filter.",
    suits="Noise of several DN on scenes with strong edges; costs weak texture.",
)
