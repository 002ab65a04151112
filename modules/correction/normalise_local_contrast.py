"""Remove local brightness and contrast from both images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import normalise_contrast, to_levels
from modules.types import Image, Views, dn_scale, full_scale


class NormaliseLocalContrastParams(OperatorParams):
    """Parameters of `normalise_local_contrast`."""

    sigma_px: float = Field(20.0, ge=2.0, le=100.0, description="Standard deviation of the local window, px")
    eps_dn: float = Field(2.0, ge=0.1, le=50.0, description="Added to the local standard deviation, dn; damps noise")
    clip_sigmas: float = Field(
        3.0, ge=1.0, le=8.0, description="Local standard deviations that reach 0 and full scale, 1"
    )


def normalise_local_contrast(views: Views, params: NormaliseLocalContrastParams) -> Views:
    """Replace both images by `(g - mean_s) / (std_s + eps)`, per channel, with one scaling for both.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : NormaliseLocalContrastParams

    Returns
    -------
    Views
        Images of the same shape and dtype; the local mean becomes half of full scale, values beyond `clip_sigmas` are
        clipped, the rest is rounded to nearest.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    Removes gain and offset that vary slowly over the image, such as vignetting; amplifies noise where there is no
    texture. Scaling each image by itself would bring the mismatch back.
    """
    check_pair(views, "correction.normalise_local_contrast")
    return views.with_images(_normalise(views.left, params), _normalise(views.right, params))


def _normalise(image: Image, params: NormaliseLocalContrastParams) -> Image:
    half = full_scale(image) / 2
    values: NDArray[np.float32] = normalise_contrast(image, params.sigma_px, params.eps_dn * dn_scale(image))
    return to_levels(values, half / params.clip_sigmas, half, image)


OPERATOR = Operator(
    name="correction.normalise_local_contrast",
    slot="local",
    params=NormaliseLocalContrastParams,
    function=normalise_local_contrast,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=35),
    summary="Replaces both images by their locally normalised contrast.",
    suits="Vignetting and lighting gradients with intensity-based costs; amplifies noise, useless for census.",
)
