"""Reject pixels whose match does not match back."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from modules.matching.common import at_match, require_disparity
from modules.operator import Cost, Operator, OperatorParams
from modules.types import FloatImage, Invalid, Matching


class CheckLeftRightParams(OperatorParams):
    """Parameters of `check_left_right`."""

    tolerance_px: float = Field(1.5, ge=0.25, le=8.0, description="Largest difference of the two disparities, px")
    unconfirmed: Literal["keep", "reject"] = Field(
        "keep", description="What to do where the match itself has no disparity, so that nothing speaks for or against"
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
        agrees = known & (np.abs(back - disparity.disparity_px) <= params.tolerance_px)
    if params.unconfirmed == "keep":
        agrees |= known & np.isnan(back)
    return replace(state, disparity=disparity.reject(~agrees, Invalid.LEFT_RIGHT))


OPERATOR = Operator(
    name="matching.check_left_right",
    slot="consistency",
    params=CheckLeftRightParams,
    function=check_left_right,
    cost=Cost(fixed_ms=0.2, ns_per_pixel=40.0),
    summary="Reject pixels whose match in the right image does not match back.",
    suits="Removes most occlusions and chance matches; costs a little density on slanted surfaces.",
)
