"""Smooth the disparity by a median."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from pydantic import Field

from modules.matching.common import require_disparity
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.types import FloatImage, Matching

BEYOND_PX = 1e6  # of every disparity


class MedianFilterParams(OperatorParams):
    """Parameters of `median_filter`."""

    size_px: int = Field(3, ge=1, le=5, description="Side of the window, odd (1 changes nothing), px")


def median_filter(state: Matching, params: MedianFilterParams) -> Matching:
    """Replace each valid disparity by the median of its window; gaps are left out.

    Parameters
    ----------
    state : Matching
        With a disparity.
    params : MedianFilterParams

    Returns
    -------
    Matching
        Same valid pixels; every new disparity is one of its window.

    Raises
    ------
    OperatorError
        If no matcher has run or the size is even.
    """
    disparity = require_disparity(state, "matching.median_filter")
    if params.size_px % 2 == 0:
        raise OperatorError(f"matching.median_filter: size_px {params.size_px} is even; use {params.size_px + 1}")
    if params.size_px == 1:
        return state
    # A lower median with holes at -inf and an upper one with holes at +inf bracket the median of the valid pixels;
    # neither bounds anything where most of the window is holes.
    centre = disparity.disparity_px
    low, high = (cv2.medianBlur(_patched(centre, hole), params.size_px) for hole in (-BEYOND_PX, BEYOND_PX))
    smooth = np.minimum(np.maximum(centre, low), high)
    return replace(state, disparity=replace(disparity, disparity_px=smooth))


def _patched(disparity: FloatImage, hole: float) -> FloatImage:
    """Return a copy with a value in the holes; `np.nan_to_num` takes ten times as long."""
    copy = disparity.copy()
    cv2.patchNaNs(copy, hole)
    return copy


OPERATOR = Operator(
    name="matching.median_filter",
    slot="refine",
    params=MedianFilterParams,
    function=median_filter,
    cost=Cost(fixed_ms=0.2, ns_per_pixel=5.0),
    summary="Smooth the disparity by a median over valid pixels.",
    suits="Removes single outliers and steps of subpixel noise; rounds thin structures.",
)
