"""Smooth both images."""

from __future__ import annotations

from typing import Any, cast

import cv2
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.types import Image, Views


class DenoiseGaussianParams(OperatorParams):
    """Parameters of `denoise_gaussian`."""

    sigma_px: float = Field(1.0, ge=0.3, le=5.0, description="Standard deviation of the Gaussian, px")


def denoise_gaussian(views: Views, params: DenoiseGaussianParams) -> Views:
    """Smooth both images with one Gaussian.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : DenoiseGaussianParams

    Returns
    -------
    Views
        Images of the same shape and dtype, rounded to nearest; borders are reflected.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    Helps census-based costs under strong noise; costs detail, and harms pairs that differ radiometrically.
    """
    check_pair(views, "correction.denoise_gaussian")
    return views.with_images(_smooth(views.left, params.sigma_px), _smooth(views.right, params.sigma_px))


def _smooth(image: Image, sigma_px: float) -> Image:
    smooth: Any = cv2.GaussianBlur(image, (0, 0), sigma_px)
    return cast(Image, smooth)


OPERATOR = Operator(
    name="correction.denoise_gaussian",
    slot="denoise",
    params=DenoiseGaussianParams,
    function=denoise_gaussian,
    cost=Cost(fixed_ms=0.3, ns_per_pixel=6),
    summary="Smooths both images with a Gaussian.",
    suits="Noise of several DN with a census cost; harms clean pairs and pairs that differ radiometrically.",
)
