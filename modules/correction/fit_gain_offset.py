"""Remove a gain and an offset between the images."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from modules.correction._shared import channel_histograms, check_pair, shared_shift_px
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.photometry import apply_tables
from modules.primitives.statistics import Floats, quantiles
from modules.primitives.statistics import fit_gain_offset as fit_quantiles
from modules.types import Views

PROBABILITIES = np.linspace(0.01, 0.99, 99)


class FitGainOffsetParams(OperatorParams):
    """Parameters of `fit_gain_offset`."""

    reference: Literal["left", "right"] = Field("left", description="Image that stays as it is")
    channels: Literal["gray", "each"] = Field("each", description="One luminance fit, or one fit per colour channel")
    common_view: bool = Field(True, description="Fit over the columns that both images see")


def fit_gain_offset(views: Views, params: FitGainOffsetParams) -> Views:
    """Fit one gain and offset to the quantiles of the images and undo them in the image that is not the reference.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : FitGainOffsetParams

    Returns
    -------
    Views
        Images of the same shape and dtype, clipped to the range of the dtype and rounded to nearest.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype, or the fitted gain lies outside 0.05 to 20.

    Notes
    -----
    Quantiles near 0 and full scale are left out, so clipping does not bias the gain. Steadier than a histogram match
    where contents differ; cannot remove a curve.

    References
    ----------
    I. J. Cox, S. Roy, S. L. Hingorani, Dynamic histogram warping of image pairs for constant image brightness, ICIP
    1995 (the problem); P. J. Huber, Robust Statistics, 1981 (the fit).
    """
    check_pair(views, "correction.fit_gain_offset")
    shift = shared_shift_px(views) if params.common_view else 0
    left, right = channel_histograms(views, shift, params.channels)
    reference, other = (left, right) if params.reference == "left" else (right, left)
    tables = [_table(source, target) for source, target in zip(other, reference, strict=True)]
    if params.reference == "left":
        return views.with_images(views.left, apply_tables(views.right, tables))
    return views.with_images(apply_tables(views.left, tables), views.right)


def _table(source: Floats, target: Floats) -> Floats:
    top = len(source) - 1
    gain, offset, _ = fit_quantiles(quantiles(source, PROBABILITIES), quantiles(target, PROBABILITIES), top)
    if not 0.05 <= gain <= 20:
        raise OperatorError(
            f"correction.fit_gain_offset: fitted gain {gain:.3g} is outside 0.05 to 20; "
            "the images hardly share a histogram, use correction.match_histograms"
        )
    return np.clip(gain * np.arange(top + 1) + offset, 0, top)


OPERATOR = Operator(
    name="correction.fit_gain_offset",
    slot="radiometry",
    params=FitGainOffsetParams,
    function=fit_gain_offset,
    cost=Cost(fixed_ms=3.0, ns_per_pixel=18),
    summary="Fits a gain and an offset to the quantiles of both images and undoes them in one image.",
    suits="Exposure differences of linear cameras, also with clipping; does not remove response curves or local light.",
)
