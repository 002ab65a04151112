"""Match blocks: the cheapest matcher."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.matching.common import Bytes, assemble, checked_range, match_both, to_bytes
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.types import Matching

SMALLEST_BLOCK = 5  # limit of cv2.StereoBM


class BlockMatchParams(OperatorParams):
    """Parameters of `block_match`."""

    block_px: int = Field(15, ge=SMALLEST_BLOCK, le=51, description="Side of the block, odd, px")
    prefilter_cap: int = Field(31, ge=1, le=63, description="Limit of the horizontal derivative, DN")
    texture_threshold: int = Field(10, ge=0, le=10000, description="Least sum of absolute derivatives per block, DN")
    uniqueness_percent: int = Field(10, ge=0, le=100, description="Margin of the best cost over the second best, %")
    right_disparity: bool = Field(False, description="Also match from right to left, for the left-right check")
    reject_range_border: bool = Field(False, description="Reject pixels whose best disparity is an end of the range")


def block_match(state: Matching, params: BlockMatchParams) -> Matching:
    """Match gray blocks by their sum of absolute differences after a horizontal Sobel filter (OpenCV StereoBM).

    Parameters
    ----------
    state : Matching
        Views (H, W) or (H, W, 3), uint8 or uint16, and a range.
    params : BlockMatchParams

    Returns
    -------
    Matching
        With a disparity float32 (H, W), 1/16 px steps, NaN where invalid, and its reasons.

    Raises
    ------
    OperatorError
        If the block is even, or the images or the range cannot be matched.

    Notes
    -----
    Nearly immune to smooth radiometric differences; fattens foreground by half a block and leaves weak texture empty.

    References
    ----------
    K. Konolige, Small Vision Systems: Hardware and Implementation, Robotics Research, 1998.
    """
    if params.block_px % 2 == 0:
        raise OperatorError(f"matching.block_match: block_px {params.block_px} is even; use {params.block_px + 1}")
    search = checked_range(state, params.block_px, "matching.block_match")
    left, right = to_bytes(state.views, colour=False)

    def compute(one: Bytes, other: Bytes, least: int, count: int) -> NDArray[np.int16]:
        matcher = cv2.StereoBM.create(count, params.block_px)
        matcher.setMinDisparity(least)
        matcher.setPreFilterType(cv2.STEREO_BM_PREFILTER_XSOBEL)
        matcher.setPreFilterCap(params.prefilter_cap)
        matcher.setTextureThreshold(params.texture_threshold)
        matcher.setUniquenessRatio(params.uniqueness_percent)
        return np.asarray(matcher.compute(one, other), np.int16)

    margin = params.block_px // 2
    disparity, right_px = match_both(compute, left, right, search, margin, params.right_disparity)
    return assemble(state, disparity, right_px, params.reject_range_border)


OPERATOR = Operator(
    name="matching.block_match",
    slot="matcher",
    params=BlockMatchParams,
    function=block_match,
    cost=Cost(fixed_ms=2.0, ns_per_pixel=32.0, ns_per_pixel_disparity=0.5),
    summary="Match blocks after a horizontal Sobel filter.",
    suits="Fastest and nearly immune to smooth radiometric differences; blurs depth edges, leaves weak texture empty.",
)
