"""Reject pixels whose cost hardly depends on the disparity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from modules.matching.common import require_disparity
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.agreement import LAST_CODE, SCALES, gather_evidence
from modules.types import Invalid, Matching


class CheckMinimumParams(OperatorParams):
    """Parameters of `check_minimum`."""

    largest_shift_px: float = Field(
        1.0, gt=0.0, le=8.0, description="Largest standard deviation with which the images place the match, px"
    )


def check_minimum(state: Matching, params: CheckMinimumParams) -> Matching:
    """Reject pixels that their window places only roughly: the texture is weak beside the difference of the images.

    Parameters
    ----------
    state : Matching
        With a disparity.
    params : CheckMinimumParams

    Returns
    -------
    Matching
        Rejected pixels carry `Invalid.FLAT_MINIMUM`.

    Raises
    ------
    OperatorError
        If no matcher has run.

    Notes
    -----
    The deviation is that of a least-squares match of one window on its own; smoothness may have done better.

    References
    ----------
    W. Foerstner, Quality assessment of object location and point transfer using digital image correlation techniques,
    International Archives of Photogrammetry 25(3), 1984.
    """
    disparity = require_disparity(state, "matching.check_minimum")
    evidence = gather_evidence(state.views.left, state.views.right, disparity, None)
    low, high = SCALES["localisation"]
    limit = (np.log2(params.largest_shift_px) - low) / (high - low) * LAST_CODE
    where = evidence.valid & (evidence.codes("localisation") > limit)
    return replace(state, disparity=disparity.reject(where, Invalid.FLAT_MINIMUM))


OPERATOR = Operator(
    name="matching.check_minimum",
    slot="minimum",
    params=CheckMinimumParams,
    function=check_minimum,
    cost=Cost(fixed_ms=0.5, ns_per_pixel=50.0),
    summary="Reject pixels whose cost hardly depends on the disparity.",
    suits="Tasks that tolerate holes but no guesses; empties weak texture under noise.",
)
