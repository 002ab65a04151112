"""Reject pixels for which another disparity fits nearly as well."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from pydantic import Field

from modules.matching.common import checked_range, require_disparity, to_bytes
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.types import Invalid, Matching

NEIGHBOURHOOD_PX = 1.5  # disparities this near to the found one are the same minimum
DERIVATIVE_LIMIT_DN = 63.0  # as in the prefilter of OpenCV's matchers


class CheckUniquenessParams(OperatorParams):
    """Parameters of `check_uniqueness`."""

    window_px: int = Field(9, ge=3, le=31, description="Side of the window over which the cost is averaged, odd, px")
    margin_percent: float = Field(
        5.0, ge=0.0, le=100.0, description="Least excess of the cost of every other disparity over the found one, %"
    )


def check_uniqueness(state: Matching, params: CheckUniquenessParams) -> Matching:
    """Reject pixels where a disparity away from the found one has nearly the same local cost, or a lower one.

    The cost is the mean absolute difference of horizontal derivatives over a window, whatever the matcher used.

    Parameters
    ----------
    state : Matching
        With a range and a disparity.
    params : CheckUniquenessParams

    Returns
    -------
    Matching
        Rejected pixels carry `Invalid.NOT_UNIQUE`.

    Raises
    ------
    OperatorError
        If no matcher has run or the window is even.

    Notes
    -----
    Rejects weak texture that a semi-global matcher has bridged correctly: use it where wrong points cost more than
    missing ones, or where texture repeats.
    """
    name = "matching.check_uniqueness"
    disparity = require_disparity(state, name)
    if params.window_px % 2 == 0:
        raise OperatorError(f"{name}: window_px {params.window_px} is even; use {params.window_px + 1}")
    search = checked_range(state, params.window_px, name)
    left, right = (
        np.clip(cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3) / 4.0, -DERIVATIVE_LIMIT_DN, DERIVATIVE_LIMIT_DN)
        for image in to_bytes(state.views, colour=False)
    )
    columns = left.shape[1]
    found = np.full(left.shape, np.inf, np.float32)
    other = np.full(left.shape, np.inf, np.float32)
    size = (params.window_px, params.window_px)
    for candidate in range(search.min_px, search.max_px):
        start, stop = max(candidate, 0), min(columns + candidate, columns)
        if stop <= start:
            continue
        cost = np.abs(left[:, start:stop] - right[:, start - candidate : stop - candidate])
        cost = cv2.boxFilter(cost, -1, size, borderType=cv2.BORDER_REPLICATE)
        with np.errstate(invalid="ignore"):
            near = np.abs(disparity.disparity_px[:, start:stop] - candidate) <= NEIGHBOURHOOD_PX
        strip = (slice(None), slice(start, stop))
        np.minimum(found[strip], cost, out=found[strip], where=near)
        np.minimum(other[strip], cost, out=other[strip], where=~near)
    with np.errstate(invalid="ignore"):
        ambiguous = ~(found * (1.0 + params.margin_percent / 100.0) < other)
    return replace(state, disparity=disparity.reject(ambiguous, Invalid.NOT_UNIQUE))


OPERATOR = Operator(
    name="matching.check_uniqueness",
    slot="uniqueness",
    params=CheckUniquenessParams,
    function=check_uniqueness,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=20.0, ns_per_pixel_disparity=8.0),
    summary="Reject pixels for which another disparity fits nearly as well.",
    suits="Repetitive texture, and tasks that tolerate holes but no wrong points; empties weak texture.",
)
