"""Match histograms by dynamic histogram warping."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from modules.correction._shared import channel_histograms, check_pair, shared_shift_px
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.histogram_warping import warp_levels
from modules.primitives.photometry import apply_tables
from modules.primitives.statistics import Floats
from modules.types import Views


class WarpHistogramsDynamicallyParams(OperatorParams):
    """Parameters of `warp_histograms_dynamically`."""

    reference: Literal["left", "right"] = Field("left", description="Image that stays as it is")
    channels: Literal["gray", "each"] = Field("each", description="One luminance map, or one map per colour channel")
    common_view: bool = Field(True, description="Take the histograms over the columns that both images see")
    max_run: int = Field(
        16, ge=2, le=64, description="Most levels of one image that one level of the other may take, 1"
    )
    levels: int = Field(256, ge=16, le=1024, description="Levels that 16-bit histograms are gathered into, 1")


def warp_histograms_dynamically(views: Views, params: WarpHistogramsDynamicallyParams) -> Views:
    """Map one image through the increasing table that warps its histogram onto the other one at the least cost.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; masked pixels are left out of the histograms.
    params : WarpHistogramsDynamicallyParams

    Returns
    -------
    Views
        Images of the same shape and dtype, rounded to nearest. A level that takes several levels of the reference goes
        to their mean, weighted by the reference; 16-bit tables are interpolated between their `levels` nodes.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype or all pixels are masked.

    Notes
    -----
    Removes what one increasing map can; where contents differ it distorts less than matching distributions, because
    counts may disagree. The slope of the map is bounded by `max_run`. On equal images it is the identity for 8 bit.

    References
    ----------
    I. J. Cox, S. Roy, S. L. Hingorani, Dynamic histogram warping of image pairs for constant image brightness, ICIP
    1995.
    """
    check_pair(views, "correction.warp_histograms_dynamically")
    shift = shared_shift_px(views) if params.common_view else 0
    left, right = channel_histograms(views, shift, params.channels)
    source, target = (right, left) if params.reference == "left" else (left, right)
    bins = 256 if views.left.dtype == np.uint8 else params.levels
    tables = warp_levels(_gather(source, bins), _gather(target, bins), params.max_run).tables
    full = [_spread(table, len(source[0])) for table in tables]
    if params.reference == "left":
        return views.with_images(views.left, apply_tables(views.right, full))
    return views.with_images(apply_tables(views.left, full), views.right)


def _gather(histograms: list[Floats], bins: int) -> Floats:
    """Return the histograms over `bins` levels, (C, bins)."""
    stacked = np.stack(histograms)
    index = np.arange(stacked.shape[1]) * bins // stacked.shape[1]
    return np.stack([np.bincount(index, weights=counts, minlength=bins) for counts in stacked])


def _spread(table: Floats, levels: int) -> Floats:
    """Return a table over `levels` levels from one over fewer, linear between the middles of its bins."""
    width = levels / len(table)
    middles = (np.arange(len(table)) + 0.5) * width - 0.5
    return np.interp(np.arange(levels), middles, (table + 0.5) * width - 0.5)


OPERATOR = Operator(
    name="correction.warp_histograms_dynamically",
    slot="radiometry",
    params=WarpHistogramsDynamicallyParams,
    function=warp_histograms_dynamically,
    cost=Cost(fixed_ms=17.0, ns_per_pixel=15),
    summary="Warps the histogram of one image onto the other one by dynamic programming and maps its levels along.",
    suits="Exposure, response curve and colour differences; not differences that vary over the image.",
)
