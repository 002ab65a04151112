"""Blur the sharper image until both are equally sharp."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.correction._shared import check_pair, shared_shift_px
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.noise import estimate_noise_dn
from modules.primitives.photometry import common_view, to_8_bit, to_gray
from modules.primitives.statistics import Floats, fit_linear
from modules.types import Image, Views

Gray = NDArray[np.uint8]

PATCH_PX = 64
LOW, HIGH = 0.04, 0.25  # frequencies compared, periods per px: below lies the light, above the noise
COLUMNS = int(HIGH * PATCH_PX) + 1  # of the spectrum that hold frequencies compared
ABOVE_NOISE = 3.0  # least power over that of the noise


class MatchSharpnessParams(OperatorParams):
    """Parameters of `match_sharpness`."""

    strength: float = Field(1.0, gt=0, le=1.0, description="Share of the missing blur that is added, 1")
    least_sigma_px: float = Field(0.4, ge=0.2, le=3.0, description="Smaller differences of blur are left alone, px")
    largest_sigma_px: float = Field(3.0, ge=0.3, le=10.0, description="Largest blur that is added, px")


def match_sharpness(views: Views, params: MatchSharpnessParams) -> Views:
    """Blur the sharper image by the Gaussian that explains the ratio of the power spectra.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : MatchSharpnessParams

    Returns
    -------
    Views
        Images of the same shape and dtype, rounded to nearest; the less sharp image, and equally sharp pairs, stay as
        they are. Constant images have no spectrum and stay too.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    A Gaussian blur of sigma multiplies the power at frequency f by exp(-4 pi^2 f^2 sigma^2), so the log ratio of the
    spectra falls by f^2 at a rate that gain and offset do not change. Detail is lost in the sharper image.

    References
    ----------
    A. P. Pentland, A new sense for depth of field, IEEE TPAMI 9(4), 1987 (ratio of spectra).
    """
    check_pair(views, "correction.match_sharpness")
    left, right = (to_8_bit(to_gray(image)) for image in (views.left, views.right))
    squared = _blur_difference(*common_view(left, right, shared_shift_px(views)))
    sigma = params.strength * min(float(np.sqrt(abs(squared))), params.largest_sigma_px)
    if sigma < params.least_sigma_px:
        return views
    if squared > 0:  # the right image is the blurred one
        return views.with_images(_blur(views.left, sigma), views.right)
    return views.with_images(views.left, _blur(views.right, sigma))


def _blur(image: Image, sigma: float) -> Image:
    return cast(Image, cv2.GaussianBlur(image, (0, 0), sigma))


def _blur_difference(left: Gray, right: Gray) -> float:
    """Return the variance of the blur of the right image minus that of the left one, px^2; 0 where unknown."""
    if min(left.shape) < PATCH_PX:
        return 0.0
    spectra = [_power(np.ascontiguousarray(image)) for image in (left, right)]
    rows, columns = np.fft.fftfreq(PATCH_PX), np.fft.rfftfreq(PATCH_PX)[:COLUMNS]
    squared = rows[:, None] ** 2 + columns[None, :] ** 2
    band = (squared >= LOW**2) & (squared <= HIGH**2)
    for power, noise in spectra:
        band &= power > (ABOVE_NOISE + 1) * noise
    if np.count_nonzero(band) < 30:
        return 0.0
    ratio = np.log((spectra[1][0] - spectra[1][1])[band] / (spectra[0][0] - spectra[0][1])[band])
    design = np.stack([squared[band], np.ones(int(band.sum()))], axis=1)
    coefficients, covariance, _ = fit_linear(design, ratio, 0.02)
    if abs(coefficients[0]) < 3 * np.sqrt(max(float(covariance[0, 0]), 0.0)):
        return 0.0
    return float(-coefficients[0] / (4 * np.pi**2))


def _power(gray: Gray) -> tuple[Floats, float]:
    """Return the first columns of the mean power spectrum of half-overlapping patches, and the noise's power in it."""
    half = PATCH_PX // 2
    window = np.outer(np.hanning(PATCH_PX), np.hanning(PATCH_PX))
    weight = window.astype(np.float32)
    patches = np.lib.stride_tricks.sliding_window_view(gray, (PATCH_PX, PATCH_PX))[::half, ::half]
    squares = np.zeros((PATCH_PX, PATCH_PX))
    for strip in patches:
        values = strip.astype(np.float32)
        values -= values.mean(axis=(1, 2), keepdims=True)
        values *= weight
        for patch in values:
            cv2.accumulateSquare(cv2.dft(patch), squares)
    noise = estimate_noise_dn(gray)
    power = unpacked(squares) / (patches.shape[0] * patches.shape[1])
    return power, float((window**2).sum()) * (noise**2 + 1 / 12)


def unpacked(squares: Floats) -> Floats:
    """Return the first columns of a power spectrum from the squares of a spectrum that OpenCV packed."""
    power = np.empty((PATCH_PX, COLUMNS))
    power[:, 1:] = squares[:, 1:-1:2][:, : COLUMNS - 1] + squares[:, 2::2][:, : COLUMNS - 1]
    rising = squares[1:-1:2, 0] + squares[2::2, 0]  # the first column is symmetric and packed in itself
    power[:, 0] = [squares[0, 0], *rising, squares[-1, 0], *rising[::-1]]
    return power


OPERATOR = Operator(
    name="correction.match_sharpness",
    slot="sharpness",
    params=MatchSharpnessParams,
    function=match_sharpness,
    cost=Cost(fixed_ms=2.0, ns_per_pixel=30),
    summary="Blurs the sharper image until both are equally sharp.",
    suits="One image out of focus before costs of raw intensity; it costs the detail of the sharper image.",
)
