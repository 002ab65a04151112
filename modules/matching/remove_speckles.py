"""Reject small islands of similar disparity."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from pydantic import Field

from modules.matching.common import FIXED_POINT_STEPS, require_disparity
from modules.operator import Cost, Operator, OperatorParams
from modules.types import Invalid, Matching


class RemoveSpecklesParams(OperatorParams):
    """Parameters of `remove_speckles`."""

    max_size_px: int = Field(100, ge=0, le=100000, description="Largest area of an island that is removed, px")
    max_difference_px: float = Field(
        1.0, ge=0.0625, le=16.0, description="Largest difference of neighbours in one island, px"
    )


def remove_speckles(state: Matching, params: RemoveSpecklesParams) -> Matching:
    """Reject 4-connected groups of at most `max_size_px` pixels whose neighbours differ by little.

    Parameters
    ----------
    state : Matching
        With a disparity.
    params : RemoveSpecklesParams

    Returns
    -------
    Matching
        Rejected pixels carry `Invalid.SPECKLE`; the others are unchanged.

    Raises
    ------
    OperatorError
        If no matcher has run.

    Notes
    -----
    Disparities are compared in steps of 1/16 px. Removes thin true structures too: lower the size on small images.
    """
    disparity = require_disparity(state, "matching.remove_speckles")
    largest = float(np.fmax.reduce(np.abs(disparity.disparity_px), axis=None))
    if params.max_size_px == 0 or np.isnan(largest):
        return state
    scale = FIXED_POINT_STEPS / max(FIXED_POINT_STEPS * largest / 30000.0, 1.0)
    empty = -32768
    scaled = disparity.disparity_px * np.float32(scale)
    cv2.patchNaNs(scaled, empty)
    fixed = np.rint(scaled, out=scaled).astype(np.int16)
    cv2.filterSpeckles(fixed, empty, params.max_size_px, round(params.max_difference_px * scale))
    return replace(state, disparity=disparity.reject(fixed == empty, Invalid.SPECKLE))


OPERATOR = Operator(
    name="matching.remove_speckles",
    slot="speckles",
    params=RemoveSpecklesParams,
    function=remove_speckles,
    cost=Cost(fixed_ms=0.1, ns_per_pixel=20.0),
    summary="Reject small islands of similar disparity.",
    suits="Removes chance matches that survive the other checks; harms thin structures.",
)
