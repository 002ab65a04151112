"""Mask the sky."""

from __future__ import annotations

from dataclasses import replace

from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import to_8_bit, to_gray
from modules.primitives.sky import find_sky
from modules.types import Views


class MaskSkyParams(OperatorParams):
    """Parameters of `mask_sky`."""

    texture_dn: float = Field(4.0, ge=0.5, le=30, description="Largest local standard deviation of sky, dn")
    brighter_dn: float = Field(
        10.0, ge=-50, le=200, description="Least excess of sky over the median of the lower half of the image, dn"
    )


def mask_sky(views: Views, params: MaskSkyParams) -> Views:
    """Set `left_mask` False on the smooth bright region connected with the top border of the left image.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : MaskSkyParams

    Returns
    -------
    Views
        Images and right mask unchanged; `left_mask` is the previous one without the sky.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    For outdoor scenes with the horizon in view: a smooth bright wall at the top of an indoor image looks the same.
    """
    check_pair(views, "correction.mask_sky")
    usable = ~find_sky(to_8_bit(to_gray(views.left)), params.texture_dn, params.brighter_dn)
    if views.left_mask is not None:
        usable &= views.left_mask
    return replace(views, left_mask=usable)


OPERATOR = Operator(
    name="correction.mask_sky",
    slot="masks",
    params=MaskSkyParams,
    function=mask_sky,
    cost=Cost(fixed_ms=1.5, ns_per_pixel=4),
    summary="Masks the smooth bright region connected with the top border of the left image.",
    suits="Outdoor scenes with the horizon in view; masks bright walls of indoor scenes too.",
)
