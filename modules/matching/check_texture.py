"""Reject pixels around which nothing changes along the row."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from pydantic import Field

from modules.matching.common import require_disparity
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.photometry import to_8_bit, to_gray
from modules.types import Invalid, Matching


class CheckTextureParams(OperatorParams):
    """Parameters of `check_texture`."""

    window_px: int = Field(9, ge=3, le=31, description="Side of the window, odd, px")
    least_dn: float = Field(
        1.0, ge=0.0, le=60.0, description="Least root mean square of the horizontal gradient in the window, DN/px"
    )


def check_texture(state: Matching, params: CheckTextureParams) -> Matching:
    """Reject pixels in whose window the left image hardly changes along the row.

    Parameters
    ----------
    state : Matching
        With a disparity.
    params : CheckTextureParams

    Returns
    -------
    Matching
        Rejected pixels carry `Invalid.TEXTURELESS`.

    Raises
    ------
    OperatorError
        If no matcher has run or the window is even.

    Notes
    -----
    A semi-global matcher bridges weak texture, mostly rightly: use it where a wrong point costs more than a missing
    one. The gradient of pure noise of standard deviation s has a root mean square of 0.43 s.
    """
    name = "matching.check_texture"
    disparity = require_disparity(state, name)
    if params.window_px % 2 == 0:
        raise OperatorError(f"{name}: window_px {params.window_px} is even; use {params.window_px + 1}")
    gray = to_8_bit(to_gray(state.views.left))
    slope = cv2.Sobel(gray, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    energy = cv2.sqrBoxFilter(
        slope, cv2.CV_32F, (params.window_px, params.window_px), borderType=cv2.BORDER_REFLECT_101
    )
    return replace(state, disparity=disparity.reject(energy < np.float32(params.least_dn**2), Invalid.TEXTURELESS))


OPERATOR = Operator(
    name="matching.check_texture",
    slot="texture",
    params=CheckTextureParams,
    function=check_texture,
    cost=Cost(fixed_ms=0.2, ns_per_pixel=12.0),
    summary="Reject pixels around which nothing changes along the row.",
    suits="Block matching, and tasks that tolerate holes but no guesses; empties what a semi-global matcher bridges.",
)
