"""Spread the histogram of each image evenly."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from modules.correction._shared import channel_histograms, check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import apply_tables
from modules.primitives.statistics import Floats
from modules.types import Views


class EqualizeHistogramParams(OperatorParams):
    """Parameters of `equalize_histogram`."""

    channels: Literal["gray", "each"] = Field("each", description="One luminance map, or one map per colour channel")
    joint: bool = Field(False, description="One map for both images, from both histograms, instead of one map for each")


def equalize_histogram(views: Views, params: EqualizeHistogramParams) -> Views:
    """Map each image by `y' = y (max - min) + min`, where y is its cumulative distribution.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; masked pixels are left out of the histograms.
    params : EqualizeHistogramParams

    Returns
    -------
    Views
        Images of the same shape and dtype, rounded to nearest; min and max are the occupied ends of each histogram, so
        a constant channel stays as it is.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype or all pixels are masked.

    Notes
    -----
    Equal scenes get equal histograms whatever the exposure; content that only one image sees bends its map, and noise
    in smooth regions is amplified. A joint map raises contrast and leaves the difference between the images.

    References
    ----------
    P. Correal, G. Pajares, J. J. Ruz, Automatic expert system for 3D terrain reconstruction based on stereo vision and
    histogram matching, Expert Systems with Applications 41, 2014 (the formula, per channel R, G, B).
    """
    check_pair(views, "correction.equalize_histogram")
    left, right = channel_histograms(views, 0, params.channels)
    if params.joint:
        left = right = [a + b for a, b in zip(left, right, strict=True)]
    return views.with_images(
        apply_tables(views.left, [_table(counts) for counts in left]),
        apply_tables(views.right, [_table(counts) for counts in right]),
    )


def _table(counts: Floats) -> Floats:
    occupied = np.flatnonzero(counts)
    low, high = float(occupied[0]), float(occupied[-1])
    return np.asarray(np.cumsum(counts) / counts.sum() * (high - low) + low, dtype=np.float64)


OPERATOR = Operator(
    name="correction.equalize_histogram",
    slot="radiometry",
    params=EqualizeHistogramParams,
    function=equalize_histogram,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=12),
    summary="Spreads the histogram of each image evenly over its range, per channel or for luminance.",
    suits="Exposure and response differences with equal content; harms under vignetting, local light and noise.",
)
