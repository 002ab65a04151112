"""Give every region of one image the mean and contrast that the other image has there."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from modules.correction._corresponding import Corresponding, corresponding
from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import to_levels
from modules.types import FloatImage, Image, Views, dn_scale

SUPPORT = 0.02  # least share of a window that must match before its statistics count


class TransferLocalAffineParams(OperatorParams):
    """Parameters of `transfer_local_affine`."""

    reference: Literal["left", "right"] = Field("left", description="Image that stays as it is")
    radius_fraction: float = Field(
        0.06, ge=0.01, le=0.3, description="Half the side of the window, fraction of the image width"
    )
    damping_dn: float = Field(4.0, ge=0.1, le=50.0, description="Added to the local deviations, in quadrature, dn")
    gain_limit: float = Field(5.0, ge=1.0, le=20.0, description="Largest local gain, and inverse of the smallest, 1")


def transfer_local_affine(views: Views, params: TransferLocalAffineParams) -> Views:
    """Map one image by a gain and an offset that vary over it, from the statistics of corresponding windows.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; channels are mapped by themselves, masked pixels give no statistics.
    params : TransferLocalAffineParams

    Returns
    -------
    Views
        Images of the same shape and dtype, clipped to the range of the dtype and rounded to nearest.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype, or hardly anything matches in their thumbnails.

    Notes
    -----
    A dense match of thumbnails, immune to light, says which windows correspond. The gain is the ratio of the
    deviations, the offset what then brings the means together; both are averaged over the window once more, and windows
    that did not match take those of their surroundings. Removes vignetting, gradients, shadows wider than the window
    and, as a special case, exposure; a hard shadow edge keeps a seam as wide as the window. It trusts the coarse match:
    things thinner than the window take the light of what lies behind them.

    References
    ----------
    E. Reinhard, M. Ashikhmin, B. Gooch, P. Shirley, Color transfer between images, IEEE CG&A 21(5), 2001 (mean and
    deviation); K. He, J. Sun, X. Tang, Guided image filtering, IEEE TPAMI 35(6), 2013 (averaged local coefficients).
    """
    check_pair(views, "correction.transfer_local_affine")
    seen = corresponding(views, params.reference, "correction.transfer_local_affine")
    gain, offset = _coefficients(seen, params)
    if params.reference == "left":
        return views.with_images(views.left, _apply(views.right, gain, offset))
    return views.with_images(_apply(views.left, gain, offset), views.right)


def _coefficients(seen: Corresponding, params: TransferLocalAffineParams) -> tuple[FloatImage, FloatImage]:
    """Return gain and offset in DN, each float32 (h, w, C)."""
    shape = seen.source.shape
    side = 2 * max(1, round(params.radius_fraction * shape[1])) + 1
    use = seen.valid.astype(np.float32)[..., None]

    def mean(values: FloatImage) -> FloatImage:
        boxed = cv2.blur(values, (side, side), borderType=cv2.BORDER_REFLECT_101)
        return np.asarray(boxed, dtype=np.float32).reshape(*shape[:2], -1)

    support = mean(use)
    weight = np.maximum(support, np.float32(1e-6))
    means = [mean(image * use) / weight for image in (seen.source, seen.reference)]
    spreads = [
        np.maximum(mean(image * image * use) / weight - average * average, 0) + np.float32(params.damping_dn**2)
        for image, average in zip((seen.source, seen.reference), means, strict=True)
    ]
    gain = np.clip(np.sqrt(spreads[1] / spreads[0]), 1 / params.gain_limit, params.gain_limit)
    offset = means[1] - gain * means[0]
    trust = np.where(support > SUPPORT, support, np.float32(1e-6))
    total = mean(trust)
    return np.asarray(mean(gain * trust) / total), np.asarray(mean(offset * trust) / total)


def _apply(image: Image, gain: FloatImage, offset: FloatImage) -> Image:
    size = (image.shape[1], image.shape[0])
    factor, shift = (
        np.asarray(cv2.resize(x, size, interpolation=cv2.INTER_LINEAR), np.float32).reshape(image.shape)
        for x in (gain, offset * np.float32(dn_scale(image)))
    )
    factor *= image
    factor += shift
    return to_levels(factor, 1.0, 0.0, image)


OPERATOR = Operator(
    name="correction.transfer_local_affine",
    slot="local",
    params=TransferLocalAffineParams,
    function=transfer_local_affine,
    cost=Cost(fixed_ms=12.0, ns_per_pixel=35),
    summary="Gives every region of one image the mean and contrast that the other image has there.",
    suits="Vignetting, lighting gradients, soft shadows and exposure together; useless for census.",
)
