"""Give both images one histogram."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from modules.correction._shared import channel_histograms, check_pair, shared_shift_px
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import apply_tables
from modules.primitives.statistics import Floats, limit_slope, match_levels
from modules.types import Views


class MatchHistogramsParams(OperatorParams):
    """Parameters of `match_histograms`."""

    reference: Literal["left", "right", "midway"] = Field(
        "left", description="Image whose histogram both shall have; midway: the mean of both quantile functions"
    )
    channels: Literal["gray", "each"] = Field("each", description="One luminance map, or one map per colour channel")
    slope_limit: float = Field(
        20.0, ge=1.0, le=20.0, description="Largest slope of a map over its slope in the middle of the histogram, 1"
    )
    common_view: bool = Field(True, description="Take the histograms over the columns that both images see")


def match_histograms(views: Views, params: MatchHistogramsParams) -> Views:
    """Map one image, or both, through an increasing table so that the histograms agree.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; masked pixels are left out of the histograms.
    params : MatchHistogramsParams

    Returns
    -------
    Views
        Images of the same shape and dtype, rounded to nearest.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype or all pixels are masked.

    Notes
    -----
    Removes differences of exposure, response curve and, with `channels="each"`, colour; not differences that vary over
    the image. Mid-bin CDFs make it the identity on equal images. A slope limit of 1 to 3 keeps noise in black shadows,
    where many pixels share few levels, from being spread over many; it also keeps strong curves from being undone
    there.

    References
    ----------
    P. Correal, G. Pajares, J. J. Ruz, Automatic expert system for 3D terrain reconstruction based on stereo vision and
    histogram matching, Expert Systems with Applications 41, 2014; J. Delon, Midway image equalization, JMIV 2004.
    """
    check_pair(views, "correction.match_histograms")
    shift = shared_shift_px(views) if params.common_view else 0
    left, right = channel_histograms(views, shift, params.channels)
    if params.reference == "left":
        return views.with_images(views.left, apply_tables(views.right, _tables(right, left, params.slope_limit)))
    if params.reference == "right":
        return views.with_images(apply_tables(views.left, _tables(left, right, params.slope_limit)), views.right)
    return views.with_images(
        apply_tables(views.left, [_halfway(table) for table in _tables(left, right, params.slope_limit)]),
        apply_tables(views.right, [_halfway(table) for table in _tables(right, left, params.slope_limit)]),
    )


def _tables(sources: list[Floats], references: list[Floats], slope_limit: float) -> list[Floats]:
    """Return the map of each channel that gives a source its reference's histogram."""
    return [
        limit_slope(match_levels(source, reference), source, slope_limit)
        for source, reference in zip(sources, references, strict=True)
    ]


def _halfway(table: Floats) -> Floats:
    return (np.arange(len(table)) + table) / 2


OPERATOR = Operator(
    name="correction.match_histograms",
    slot="radiometry",
    params=MatchHistogramsParams,
    function=match_histograms,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=10),
    summary="Gives both images one histogram through an increasing table, per channel or for luminance.",
    suits="Exposure, response curve and colour differences; harms where light differs locally or contents differ.",
)
