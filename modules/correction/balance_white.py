"""Bring the channels of each image to one level."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.photometry import apply_tables
from modules.types import Image, Mask, Views, full_scale

GAIN_LIMIT = 20.0  # largest gain of a channel, and inverse of the smallest


class BalanceWhiteParams(OperatorParams):
    """Parameters of `balance_white`."""

    norm: Literal["mean", "power"] = Field(
        "mean", description="mean: gray world; power: sixth-power mean, between gray world and white patch"
    )


def balance_white(views: Views, params: BalanceWhiteParams) -> Views:
    """Scale the channels of each image so that they agree on average.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; masked pixels are left out of the averages.
    params : BalanceWhiteParams

    Returns
    -------
    Views
        Images of the same shape and dtype, rounded to nearest and clipped; the average of the three channels keeps its
        value. Gray images are returned unchanged.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype, all pixels are masked, or a channel would need a gain beyond 20.

    Notes
    -----
    Works on each image by itself, so it also removes a cast that both share, and leaves a difference of exposure;
    `balance_channels` brings one image to the other.

    References
    ----------
    G. D. Finlayson and E. Trezzi, Shades of gray and colour constancy, CIC 2004 (both norms).
    """
    check_pair(views, "correction.balance_white")
    if views.left.ndim == 2:
        return views
    return views.with_images(
        _balance(views.left, views.left_mask, params, "left"), _balance(views.right, views.right_mask, params, "right")
    )


def _balance(image: Image, mask: Mask | None, params: BalanceWhiteParams, side: str) -> Image:
    if mask is not None and not mask.any():
        raise OperatorError(f"correction.balance_white: no pixel of the {side} image is unmasked; loosen the masks")
    chosen = None if mask is None else mask.astype(np.uint8)
    if params.norm == "mean":
        averages = np.array(cv2.mean(image, chosen)[:3])
    else:
        shares = (image.astype(np.float32) / np.float32(full_scale(image))) ** 6
        averages = np.array(cv2.mean(shares, chosen)[:3]) ** (1 / 6)
    gains = averages.mean() / np.maximum(averages, 1e-9)
    if averages.max() > 0 and (gains.min() < 1 / GAIN_LIMIT or gains.max() > GAIN_LIMIT):
        raise OperatorError(
            f"correction.balance_white: the channels of the {side} image need gains of {gains.min():.3g} to "
            f"{gains.max():.3g}, the limit is {GAIN_LIMIT:g}; a channel is dead or black, use another correction"
        )
    levels = np.arange(full_scale(image) + 1)
    return apply_tables(image, [levels * (gain if averages.max() > 0 else 1.0) for gain in gains])


OPERATOR = Operator(
    name="correction.balance_white",
    slot="radiometry",
    params=BalanceWhiteParams,
    function=balance_white,
    cost=Cost(fixed_ms=0.5, ns_per_pixel=8),
    summary="Scales the channels of each image so that they agree on average.",
    suits="A cast that differs between the cameras at equal exposure; leaves a difference of exposure.",
)
