"""Match blocks semi-globally with OpenCV."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.matching.common import Bytes, assemble, checked_range, match_both, to_bytes
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.types import Matching


class SemiGlobalBlockMatchParams(OperatorParams):
    """Parameters of `semi_global_block_match`."""

    mode: Literal["3way", "sgbm", "hh", "hh4"] = Field(
        "3way", description="Paths: 3 (fastest, least memory), 5, 8 or 4, as OpenCV names them"
    )
    block_px: int = Field(5, ge=1, le=21, description="Side of the block, odd, px")
    p1_factor: float = Field(
        8.0, ge=0.0, le=200.0, description="P1, penalty of a step of 1 px, per channel and block px"
    )
    p2_factor: float = Field(
        32.0, ge=0.0, le=800.0, description="P2, penalty of a larger step, per channel and block px"
    )
    prefilter_cap: int = Field(63, ge=1, le=63, description="Limit of the horizontal derivative, DN")
    uniqueness_percent: int = Field(10, ge=0, le=100, description="Margin of the best cost over the second best, %")
    colour: bool = Field(True, description="Match the three channels of RGB images instead of gray")
    right_disparity: bool = Field(False, description="Also match from right to left, for the left-right check")
    reject_range_border: bool = Field(False, description="Reject pixels whose best disparity is an end of the range")


def semi_global_block_match(state: Matching, params: SemiGlobalBlockMatchParams) -> Matching:
    """Match blocks by Birchfield-Tomasi cost with a smoothness penalty along several paths (OpenCV StereoSGBM).

    Parameters
    ----------
    state : Matching
        Views (H, W) or (H, W, 3), uint8 or uint16, and a range.
    params : SemiGlobalBlockMatchParams

    Returns
    -------
    Matching
        With a disparity float32 (H, W), 1/16 px steps, NaN where invalid, and its reasons.

    Raises
    ------
    OperatorError
        If the block is even, P2 is smaller than P1, or the images or the range cannot be matched.

    Notes
    -----
    The cost contains raw intensity: a difference of brightness between the images hurts, most on weak texture.

    References
    ----------
    H. Hirschmueller, Stereo Processing by Semiglobal Matching and Mutual Information, IEEE TPAMI 30(2), 2008.
    """
    name = "matching.semi_global_block_match"
    if params.block_px % 2 == 0:
        raise OperatorError(f"{name}: block_px {params.block_px} is even; use {params.block_px + 1}")
    if params.p2_factor < params.p1_factor:
        raise OperatorError(
            f"{name}: p2_factor {params.p2_factor:g} is smaller than p1_factor {params.p1_factor:g}; use a "
            "larger p2_factor"
        )
    search = checked_range(state, params.block_px, name)
    left, right = to_bytes(state.views, params.colour)
    weight = (left.shape[2] if left.ndim == 3 else 1) * params.block_px**2
    modes = {
        "3way": cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        "sgbm": cv2.STEREO_SGBM_MODE_SGBM,
        "hh": cv2.STEREO_SGBM_MODE_HH,
        "hh4": cv2.STEREO_SGBM_MODE_HH4,
    }
    p1 = max(round(params.p1_factor * weight), 1)

    def compute(one: Bytes, other: Bytes, least: int, count: int) -> NDArray[np.int16]:
        matcher = cv2.StereoSGBM.create(
            minDisparity=least,
            numDisparities=count,
            blockSize=params.block_px,
            P1=p1,
            P2=max(round(params.p2_factor * weight), p1 + 1),
            disp12MaxDiff=-1,  # the left-right check is an operator of its own
            preFilterCap=params.prefilter_cap,
            uniquenessRatio=params.uniqueness_percent,
            mode=modes[params.mode],
        )
        return np.asarray(matcher.compute(one, other), np.int16)

    disparity, right_px = match_both(compute, left, right, search, 0, params.right_disparity)
    return assemble(state, disparity, right_px, params.reject_range_border)


OPERATOR = Operator(
    name="matching.semi_global_block_match",
    slot="matcher",
    params=SemiGlobalBlockMatchParams,
    function=semi_global_block_match,
    cost=Cost(fixed_ms=2.0, ns_per_pixel=40.0, ns_per_pixel_disparity=1.7),
    summary="Match blocks with a smoothness penalty along several paths.",
    suits="Robust to noise and blur, fast; harmed by brightness differences on weak texture.",
)
