"""Reject pixels whose match does not match back."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from modules.matching.common import at_match, require_disparity
from modules.operator import Cost, Operator, OperatorParams
from modules.types import FloatImage, Invalid, Mask, Matching, blanked

SURFACE_RADIUS = 3  # half side of the window in which a surface must go on, px
SURFACE_PX = 1.0  # largest difference of disparities on one surface, px
SURFACE_SHARE = 0.2  # of the window that must be confirmed and of one surface
CONTRADICTED = 4.0  # times the excess is asked where the match would hide what the right image shows


class CheckLeftRightParams(OperatorParams):
    """Parameters of `check_left_right`."""

    tolerance_px: float = Field(1.5, ge=0.25, le=8.0, description="Largest difference of the two disparities, px")
    unconfirmed: Literal["keep", "reject"] = Field(
        "keep", description="What to do where the match itself has no disparity, so that nothing speaks for or against"
    )
    strong_excess: float = Field(
        0.0,
        ge=0.0,
        le=4.0,
        description="Least excess of the second best cost over the best, as a share of it, at which a pixel that goes "
        "on with a confirmed surface is kept though it does not match back; 0: none is",
    )


def project_to_right(disparity: FloatImage) -> FloatImage:
    """Return the left disparities seen from the right image: where several meet, the nearest (largest) one.

    Parameters
    ----------
    disparity : float32 (H, W)
        px, NaN where invalid.

    Returns
    -------
    float32 (H, W)
        Indexed by right column, NaN where nothing lands.
    """
    rows, columns = disparity.shape
    row, column = np.nonzero(np.isfinite(disparity))
    value = disparity[row, column]
    target = np.rint(column - value).astype(np.int64)
    inside = (target >= 0) & (target < columns)
    seen = np.full((rows, columns), -np.inf, np.float32)
    np.maximum.at(seen, (row[inside], target[inside]), value[inside])
    seen[~np.isfinite(seen)] = np.nan
    return seen


def continues_surface(disparity: FloatImage, confirmed: Mask, asked: Mask) -> Mask:
    """Return which of the pixels asked about lie on a surface of confirmed ones.

    Parameters
    ----------
    disparity : float32 (H, W)
        px, NaN where invalid.
    confirmed, asked : bool (H, W)

    Returns
    -------
    bool (H, W)
        True where at least `SURFACE_SHARE` of the window around a pixel is confirmed and within `SURFACE_PX` of it.
    """
    side = 2 * SURFACE_RADIUS + 1
    least = math.ceil(SURFACE_SHARE * side**2)
    around = cv2.boxFilter(
        confirmed.view(np.uint8), -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT
    )  # confirmed ones, near in disparity or not
    at = np.flatnonzero(asked & (around >= least))
    value = disparity.ravel().take(at)
    border = (SURFACE_RADIUS,) * 4
    wide = cv2.copyMakeBorder(blanked(disparity, ~confirmed), *border, cv2.BORDER_CONSTANT, value=np.nan)
    corner = at + at // disparity.shape[1] * (2 * SURFACE_RADIUS)  # of the window, in the padded image
    row = corner + np.arange(side)[:, None]
    count = np.zeros(row.shape, np.uint8)
    with np.errstate(invalid="ignore"):
        for dy in range(side):
            count += np.abs(wide.ravel().take(row + dy * wide.shape[1]) - value) <= SURFACE_PX
    found = np.zeros(asked.size, bool)
    found[at] = count.sum(axis=0, dtype=np.uint8) >= least
    return found.reshape(asked.shape)


def check_left_right(state: Matching, params: CheckLeftRightParams) -> Matching:
    """Reject pixels whose disparity differs from that of their match in the right image.

    Parameters
    ----------
    state : Matching
        With a disparity. Where the matcher gave no disparity of the right image, the left one is projected instead,
        which finds hidden pixels covered by nearer ones but no other mismatch.
    params : CheckLeftRightParams

    Returns
    -------
    Matching
        Rejected pixels carry `Invalid.LEFT_RIGHT`.

    Notes
    -----
    The disparities of the right image come of the same costs as the left ones and bulge over what lies beside a near
    object: of the pixels seen by both cameras that the check rejects on clean pairs, two in five are right. With
    `strong_excess` of 0.2 a quarter of these is kept (`examples/evidence/left_right.py`). A match that would be nearer
    than what the right image shows there, and so would hide it, needs `CONTRADICTED` times the excess. Where the
    matcher does not know the second best cost the parameter changes nothing.

    Raises
    ------
    OperatorError
        If no matcher has run.

    References
    ----------
    P. Fua, A parallel stereo algorithm that produces dense depth maps and preserves image features, Machine Vision and
    Applications 6, 1993.
    """
    disparity = require_disparity(state, "matching.check_left_right")
    right_px = disparity.right_px
    if right_px is None:
        right_px = project_to_right(disparity.disparity_px)
    back, known = at_match(right_px, disparity.disparity_px)
    with np.errstate(invalid="ignore"):
        agrees = known & (cv2.absdiff(back, disparity.disparity_px) <= params.tolerance_px)
    if params.unconfirmed == "keep":
        agrees |= known & np.isnan(back)
    if params.strong_excess > 0 and disparity.excess is not None:
        with np.errstate(invalid="ignore"):
            strong = (disparity.excess >= params.strong_excess) & (back > disparity.disparity_px)
            strong |= disparity.excess >= CONTRADICTED * params.strong_excess
        agrees |= continues_surface(disparity.disparity_px, agrees, strong & known & ~agrees)
    return replace(state, disparity=disparity.reject(~agrees, Invalid.LEFT_RIGHT))


OPERATOR = Operator(
    name="matching.check_left_right",
    slot="consistency",
    params=CheckLeftRightParams,
    function=check_left_right,
    cost=Cost(fixed_ms=0.2, ns_per_pixel=10.0),
    summary="Reject pixels whose match in the right image does not match back.",
    suits="Removes most occlusions and chance matches; costs a little density on slanted surfaces.",
)
