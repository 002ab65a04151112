"""Reject pixels that are clipped in either image."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from pydantic import Field

from modules.matching.common import at_match, require_disparity
from modules.operator import Cost, Operator, OperatorParams
from modules.types import Image, Invalid, Mask, Matching, dn_scale, full_scale


class CheckSaturationParams(OperatorParams):
    """Parameters of `check_saturation`."""

    level_dn: float = Field(254.0, ge=128.0, le=255.0, description="Least level of every channel that is clipped, DN")


def _clipped(image: Image, level_dn: float) -> Mask:
    least = math.ceil(level_dn * dn_scale(image))
    if image.ndim == 2:
        return np.asarray(image >= least)
    return np.asarray(cv2.inRange(image, (least,) * 3, (full_scale(image),) * 3)) != 0


def check_saturation(state: Matching, params: CheckSaturationParams) -> Matching:
    """Reject pixels that are clipped in the left image, or whose match is clipped in the right one.

    Parameters
    ----------
    state : Matching
        With a disparity; the images as they are matched.
    params : CheckSaturationParams

    Returns
    -------
    Matching
        Rejected pixels carry `Invalid.SATURATED`.

    Raises
    ------
    OperatorError
        If no matcher has run.

    Notes
    -----
    Small clipped spots are bridged rightly by a semi-global matcher; large ones are guesses.
    """
    disparity = require_disparity(state, "matching.check_saturation")
    views = state.views
    at_right, known = at_match(_clipped(views.right, params.level_dn), disparity.disparity_px)
    where = _clipped(views.left, params.level_dn) | (known & at_right)
    return replace(state, disparity=disparity.reject(np.asarray(where), Invalid.SATURATED))


OPERATOR = Operator(
    name="matching.check_saturation",
    slot="saturation",
    params=CheckSaturationParams,
    function=check_saturation,
    cost=Cost(fixed_ms=0.2, ns_per_pixel=5.0),
    summary="Reject pixels that are clipped in either image.",
    suits="Large clipped areas, which hold nothing to match; harms where small highlights are bridged.",
)
