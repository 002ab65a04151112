"""Mask clipped pixels."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import cv2
import numpy as np
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.types import Image, Mask, Views, dn_scale


class MaskSaturatedParams(OperatorParams):
    """Parameters of `mask_saturated`."""

    high_dn: float = Field(254.0, ge=128, le=255, description="A pixel is clipped if any channel reaches this, dn")
    low_dn: float = Field(0.0, ge=0, le=64, description="A pixel is black if all channels are at most this, dn")
    margin_px: int = Field(1, ge=0, le=20, description="Width by which clipped regions grow, px")


def mask_saturated(views: Views, params: MaskSaturatedParams) -> Views:
    """Set the masks False where an image is clipped or black.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : MaskSaturatedParams

    Returns
    -------
    Views
        Images unchanged; both masks are the previous ones without the clipped pixels.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.
    """
    check_pair(views, "correction.mask_saturated")
    left, right = _usable(views.left, params), _usable(views.right, params)
    if views.left_mask is not None:
        left &= views.left_mask
    if views.right_mask is not None:
        right &= views.right_mask
    return replace(views, left_mask=left, right_mask=right)


def _usable(image: Image, params: MaskSaturatedParams) -> Mask:
    scale = dn_scale(image)
    largest = image  # of the channels: clipped if any channel is, black if all are
    if image.ndim == 3:
        largest = cast(Image, np.maximum(np.maximum(image[..., 0], image[..., 1]), image[..., 2]))
    clipped: Mask = np.asarray((largest >= params.high_dn * scale) | (largest <= params.low_dn * scale))
    if params.margin_px and clipped.any():
        size = 2 * params.margin_px + 1
        clipped = np.asarray(cv2.dilate(clipped.view(np.uint8), np.ones((size, size), np.uint8)) > 0)
    return np.asarray(~clipped)


OPERATOR = Operator(
    name="correction.mask_saturated",
    slot="masks",
    params=MaskSaturatedParams,
    function=mask_saturated,
    cost=Cost(fixed_ms=0.3, ns_per_pixel=4),
    summary="Masks the pixels that are clipped or black in either image.",
    suits="Images clipped differently; masks whole regions of overexposed scenes.",
)
