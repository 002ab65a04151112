"""Mask ground without texture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import to_8_bit, to_gray
from modules.types import Views


class MaskFeaturelessParams(OperatorParams):
    """Parameters of `mask_featureless`."""

    contrast_dn: float = Field(
        2.0, ge=0.2, le=20.0, description="Least local standard deviation of textured ground, dn"
    )
    radius_px: int = Field(10, ge=2, le=50, description="Pixels from the centre of the window to its side, px")


def mask_featureless(views: Views, params: MaskFeaturelessParams) -> Views:
    """Set `left_mask` False where nothing in the window around a pixel of the left image varies.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : MaskFeaturelessParams

    Returns
    -------
    Views
        Images and right mask unchanged; `left_mask` is the previous one without the windows whose standard deviation
        of luminance is below the limit. A constant left image is masked everywhere.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    What is matched there follows from smoothness alone. Noise counts as texture: set the limit above it.
    """
    check_pair(views, "correction.mask_featureless")
    gray = to_8_bit(to_gray(views.left)).astype(np.float32)
    side = 2 * params.radius_px + 1
    mean = cv2.blur(gray, (side, side), borderType=cv2.BORDER_REFLECT_101)
    square = cv2.sqrBoxFilter(gray, cv2.CV_32F, (side, side), borderType=cv2.BORDER_REFLECT_101)
    usable = np.asarray(square - mean * mean >= params.contrast_dn**2)
    if views.left_mask is not None:
        usable &= views.left_mask
    return replace(views, left_mask=usable)


OPERATOR = Operator(
    name="correction.mask_featureless",
    slot="masks",
    params=MaskFeaturelessParams,
    function=mask_featureless,
    cost=Cost(fixed_ms=0.3, ns_per_pixel=4),
    summary="Masks the ground of the left image that has no texture.",
    suits="Wide smooth ground where a wrong height is worse than none; lowers the density.",
)
