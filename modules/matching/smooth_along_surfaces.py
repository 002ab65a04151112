"""Smooth the disparity within surfaces and not across their edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from modules.matching.common import require_disparity
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import to_8_bit, to_gray
from modules.types import Matching


class SmoothAlongSurfacesParams(OperatorParams):
    """Parameters of `smooth_along_surfaces`."""

    radius_px: int = Field(2, ge=1, le=5, description="Half side of the window, px")
    sigma_dn: float = Field(10.0, ge=1.0, le=100.0, description="Difference of gray at which the weight is 0.61, DN")
    max_difference_px: float = Field(
        0.75, ge=0.1, le=4.0, description="Neighbours whose disparity differs by more do not count, px"
    )


def smooth_along_surfaces(state: Matching, params: SmoothAlongSurfacesParams) -> Matching:
    """Replace each disparity by the mean of the neighbours of similar disparity and gray, in pairs of opposite ones.

    Neighbours count only in pairs on opposite sides, both similar, so that a slanted plane stays exactly as it is.

    Parameters
    ----------
    state : Matching
        With a disparity.
    params : SmoothAlongSurfacesParams

    Returns
    -------
    Matching
        Same valid pixels; no disparity moves by more than `max_difference_px`.

    Raises
    ------
    OperatorError
        If no matcher has run.

    References
    ----------
    C. Tomasi and R. Manduchi, Bilateral filtering for gray and color images, ICCV 1998.
    """
    disparity = require_disparity(state, "matching.smooth_along_surfaces")
    centre = disparity.disparity_px
    gray = to_8_bit(to_gray(state.views.left)).astype(np.float32)
    radius, rows, columns = params.radius_px, *centre.shape
    wide = np.pad(centre, radius, constant_values=np.nan)
    shade = np.pad(gray, radius, mode="edge")
    total, weight = np.zeros_like(centre), np.ones_like(centre)
    limit, scale = np.float32(params.max_difference_px), np.float32(-0.5 / params.sigma_dn**2)
    for dy in range(radius + 1):
        for dx in range(-radius, radius + 1):
            if dy == 0 and dx <= 0:
                continue
            ahead = (slice(radius + dy, radius + dy + rows), slice(radius + dx, radius + dx + columns))
            behind = (slice(radius - dy, radius - dy + rows), slice(radius - dx, radius - dx + columns))
            one, other = wide[ahead] - centre, wide[behind] - centre
            alike = np.exp(scale * ((shade[ahead] - gray) ** 2 + (shade[behind] - gray) ** 2))
            with np.errstate(invalid="ignore"):
                alike *= (np.abs(one) <= limit) & (np.abs(other) <= limit)
            total += alike * np.nan_to_num(one + other)
            weight += 2 * alike
    return replace(state, disparity=replace(disparity, disparity_px=(centre + total / weight).astype(np.float32)))


OPERATOR = Operator(
    name="matching.smooth_along_surfaces",
    slot="refine",
    params=SmoothAlongSurfacesParams,
    function=smooth_along_surfaces,
    cost=Cost(fixed_ms=0.5, ns_per_pixel=250.0),
    summary="Smooth the disparity within surfaces and not across their edges.",
    suits="Noisy pairs and OpenCV's matchers, whose disparities come in steps; costs finest relief.",
)
