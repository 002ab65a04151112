"""Remove a gain, an offset and a gamma between corresponding points."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from modules.correction._corresponding import corresponding
from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.photometry import apply_tables
from modules.primitives.statistics import Floats, fit_linear
from modules.types import Views, dn_scale, full_scale

PROBABILITIES = np.linspace(0.01, 0.99, 50)
GAMMAS = np.exp(np.linspace(np.log(0.25), np.log(4.0), 41))
SCALE_DN = 0.3  # least spread of the residuals assumed, dn
LEAST_POINTS = 200
GAIN_LIMIT = 20.0


class FitResponseParams(OperatorParams):
    """Parameters of `fit_response`."""

    reference: Literal["left", "right"] = Field("left", description="Image that stays as it is")
    channels: Literal["gray", "each"] = Field("each", description="One fit for all channels, or one per channel")
    model: Literal["gain", "gain_offset", "gain_offset_gamma"] = Field(
        "gain_offset_gamma", description="What may differ; gain with channels each is a balance of the channels"
    )


def fit_response(views: Views, params: FitResponseParams) -> Views:
    """Fit `reference = gain * image^gamma + offset` to corresponding points and map the other image by it.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; masked and clipped points are left out.
    params : FitResponseParams

    Returns
    -------
    Views
        Images of the same shape and dtype, clipped to the range of the dtype and rounded to nearest.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype, fewer than 200 points of their thumbnails correspond, or the gain lies
        outside 0.05 to 20.

    Notes
    -----
    Corresponding points of a dense match of thumbnails show the same content, so their quantiles may be compared
    without the bias that content of one image only brings, and without that of regression on noisy values. Two or three
    coefficients are steadier than a whole table where few levels occur, and go on beyond them.

    References
    ----------
    S. Mann and R. W. Picard, On being undigital with digital cameras, IS&T 1995 (comparametric gain and gamma); P. J.
    Huber, Robust Statistics, 1981 (the fit).
    """
    name = "correction.fit_response"
    check_pair(views, name)
    seen = corresponding(views, params.reference, name)
    count = int(np.count_nonzero(seen.valid))
    if count < LEAST_POINTS:
        raise OperatorError(
            f"{name}: {count} points of the thumbnails correspond, {LEAST_POINTS} are needed; use "
            "correction.match_histograms"
        )
    source, target = (image[seen.valid].astype(np.float64) for image in (seen.source, seen.reference))
    if params.channels == "gray":
        source, target = source.mean(axis=1, keepdims=True), target.mean(axis=1, keepdims=True)
    scale = dn_scale(views.left)
    levels = np.arange(full_scale(views.left) + 1) / scale
    tables = [scale * _curve(source[:, c], target[:, c], levels, params.model) for c in range(source.shape[1])]
    if params.reference == "left":
        return views.with_images(views.left, apply_tables(views.right, tables))
    return views.with_images(apply_tables(views.left, tables), views.right)


def _curve(source: Floats, target: Floats, levels: Floats, model: str) -> Floats:
    """Return the fitted curve at `levels`, dn."""
    from_dn, to_dn = (np.quantile(values, PROBABILITIES) for values in (source, target))
    if model == "gain":
        return _checked_gain(float(to_dn.sum() / max(from_dn.sum(), 1e-9))) * levels
    gamma = _exponent(from_dn, to_dn) if model == "gain_offset_gamma" else 1.0
    bent = 255.0 * (from_dn / 255.0) ** gamma
    (gain, offset), _, _ = fit_linear(np.stack([bent, np.ones_like(bent)], axis=1), to_dn, SCALE_DN)
    return np.asarray(_checked_gain(float(gain)) * 255.0 * (levels / 255.0) ** gamma + offset)


def _exponent(from_dn: Floats, to_dn: Floats) -> float:
    """Return the exponent whose straight line fits best; it must earn its place by more than 0.02 dn per log unit."""
    bent = 255.0 * (from_dn[None, :] / 255.0) ** GAMMAS[:, None]
    centred, wanted = bent - bent.mean(axis=1, keepdims=True), to_dn - to_dn.mean()
    gains = (centred @ wanted) / np.maximum((centred**2).sum(axis=1), 1e-9)
    misfit = np.abs(wanted - gains[:, None] * centred).mean(axis=1) + 0.02 * np.abs(np.log(GAMMAS))
    return float(GAMMAS[int(np.argmin(misfit))])


def _checked_gain(gain: float) -> float:
    if not 1 / GAIN_LIMIT <= gain <= GAIN_LIMIT:
        raise OperatorError(
            f"correction.fit_response: fitted gain {gain:.3g} is outside {1 / GAIN_LIMIT:g} to {GAIN_LIMIT:g}; the "
            "images hardly share a response, use correction.match_histograms"
        )
    return gain


OPERATOR = Operator(
    name="correction.fit_response",
    slot="radiometry",
    params=FitResponseParams,
    function=fit_response,
    cost=Cost(fixed_ms=18.0, ns_per_pixel=35),
    summary="Fits gain, offset and gamma to corresponding points and undoes them in one image.",
    suits="Exposure, response and colour where contents differ or few levels occur; not differences over the image.",
)
