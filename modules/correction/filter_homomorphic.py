"""Weaken slow changes of light by homomorphic filtering."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.correction._shared import check_pair, rescale_jointly
from modules.operator import Cost, Operator, OperatorParams
from modules.types import FloatImage, Image, Views, dn_scale

ROLL_OFF = 0.414  # Butterworth: the response is halfway in power at the cutoff


class FilterHomomorphicParams(OperatorParams):
    """Parameters of `filter_homomorphic`."""

    kind: Literal["gaussian", "butterworth"] = Field("gaussian", description="Shape of the high-emphasis response")
    low_gain: float = Field(0.5, ge=0.0, le=1.0, description="Gain of slow changes of log intensity, 1")
    high_gain: float = Field(2.0, ge=1.0, le=5.0, description="Gain of fast changes of log intensity, 1")
    cutoff: float = Field(10.0, ge=1.0, le=200.0, description="Cutoff in periods per image height, 1")
    sharpness: float = Field(1.0, ge=0.1, le=10.0, description="Factor c of the exponent of the Gaussian, 1")
    order: int = Field(2, ge=1, le=8, description="Order n of the Butterworth response, 1")


def filter_homomorphic(views: Views, params: FilterHomomorphicParams) -> Views:
    """Filter the logarithm of both images by one high-emphasis response, and rescale both by one range.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; every channel is filtered by itself.
    params : FilterHomomorphicParams

    Returns
    -------
    Views
        Images of the same shape and dtype, rounded to nearest. The 0.5th and 99.5th percentile of both images together
        become 0 and full scale; what lies beyond is clipped.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype, or nothing varies in them after filtering.

    Notes
    -----
    `ln(1 + f)`, with f in DN, makes light and reflectance add up; images are reflected at their borders, so that light
    does not leak around. Rescaling each image by itself would bring the difference back. Noise in the shadows grows.
    The two responses are `(gH - gL)(1 - exp(-c D^2 / D0^2)) + gL` and
    `gL + (gH - gL)(1 - 1 / (1 + 0.414 (D^2 / D0^2)^n))`.

    References
    ----------
    A. V. Oppenheim, R. W. Schafer, T. G. Stockham, Nonlinear filtering of multiplied and convolved signals, Proceedings
    of the IEEE 56, 1968; R. C. Gonzalez and R. E. Woods, Digital Image Processing, 2008.
    """
    check_pair(views, "correction.filter_homomorphic")
    filtered = [_filter(image, params) for image in (views.left, views.right)]
    left, right = rescale_jointly(filtered[0], filtered[1], views.left, "correction.filter_homomorphic")
    return views.with_images(left, right)


def _filter(image: Image, params: FilterHomomorphicParams) -> FloatImage:
    planes = image[..., None] if image.ndim == 2 else image
    height, width = image.shape[:2]
    pad = min(height, width) // 4
    size = tuple(cv2.getOptimalDFTSize(length + 2 * pad) for length in (height, width))
    gain = _response((size[0], size[1]), height, params)
    out = np.empty(planes.shape, np.float32)
    for channel in range(planes.shape[2]):
        log = np.log1p(planes[..., channel].astype(np.float32) / np.float32(dn_scale(image)))
        around = (pad, size[0] - height - pad, pad, size[1] - width - pad)
        padded = cv2.copyMakeBorder(log, *around, cv2.BORDER_REFLECT_101)
        spectrum = cv2.dft(padded, flags=cv2.DFT_COMPLEX_OUTPUT) * gain[..., None]
        back = cv2.dft(spectrum, flags=cv2.DFT_INVERSE | cv2.DFT_REAL_OUTPUT | cv2.DFT_SCALE)
        out[..., channel] = np.expm1(back[pad : pad + height, pad : pad + width])
    return out.reshape(image.shape)


def _response(size: tuple[int, int], height: int, params: FilterHomomorphicParams) -> NDArray[np.float32]:
    """Return the gain per frequency of a transform of `size`; D counts periods per `height` pixels."""
    rows, columns = (np.fft.fftfreq(length) * height for length in size)
    squared = (rows[:, None] ** 2 + columns[None, :] ** 2) / params.cutoff**2
    if params.kind == "gaussian":
        high = 1 - np.exp(-params.sharpness * squared)
    else:
        high = 1 - 1 / (1 + ROLL_OFF * squared**params.order)
    return np.asarray(params.low_gain + (params.high_gain - params.low_gain) * high, dtype=np.float32)


OPERATOR = Operator(
    name="correction.filter_homomorphic",
    slot="local",
    params=FilterHomomorphicParams,
    function=filter_homomorphic,
    cost=Cost(fixed_ms=2.0, ns_per_pixel=370),
    summary="Weakens slow changes of light in the logarithm of both images and rescales both by one range.",
    suits="Vignetting and soft light with intensity-based costs; amplifies noise in shadows, useless for census.",
)
