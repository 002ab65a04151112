"""Reject pixels whose disparity lies at an end of the searched range."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from modules.matching.common import require_disparity
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.types import Invalid, Matching


class CheckRangeBorderParams(OperatorParams):
    """Parameters of `check_range_border`."""

    width_px: float = Field(1.0, ge=0.25, le=16.0, description="Distance from an end of the range that is rejected, px")
    ends: Literal["both", "lower", "upper"] = Field("both", description="Ends of the range that are checked")


def check_range_border(state: Matching, params: CheckRangeBorderParams) -> Matching:
    """Reject pixels whose disparity is within `width_px` of the first or last disparity searched.

    A pixel whose true disparity lies outside of the range settles at its end, or anywhere.

    Parameters
    ----------
    state : Matching
        With a range and a disparity.
    params : CheckRangeBorderParams

    Returns
    -------
    Matching
        Rejected pixels carry `Invalid.RANGE_BORDER`.

    Raises
    ------
    OperatorError
        If no matcher has run or no range is known.

    Notes
    -----
    Rejects the sky and the horizon where the range begins at their disparity.
    """
    name = "matching.check_range_border"
    disparity = require_disparity(state, name)
    if state.range_px is None:
        raise OperatorError(f"{name}: no disparity range is known; run matching.use_range first")
    with np.errstate(invalid="ignore"):
        lower = disparity.disparity_px <= state.range_px.min_px + params.width_px
        upper = disparity.disparity_px >= state.range_px.max_px - 1 - params.width_px
    where = {"both": lower | upper, "lower": lower, "upper": upper}[params.ends]
    return replace(state, disparity=disparity.reject(where, Invalid.RANGE_BORDER))


OPERATOR = Operator(
    name="matching.check_range_border",
    slot="range_border",
    params=CheckRangeBorderParams,
    function=check_range_border,
    cost=Cost(fixed_ms=0.1, ns_per_pixel=4.0),
    summary="Reject pixels whose disparity lies at an end of the searched range.",
    suits="A range that may not be widened though disparities pile up at its end.",
)
