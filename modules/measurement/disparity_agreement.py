"""Measure how well a disparity map agrees with the two images."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np

from modules.operator import Cost
from modules.probe import FactModel, Probe, quantity
from modules.types import FloatImage, Image, Mask, Matching, dn_scale

WINDOW_PX = 9  # window of the local normalisation
NOISE_DN = 2.0  # local contrast below this is noise
SUPPORT_CORRELATION = 0.5  # least local correlation of a pixel whose match is supported by the images
ROW_STEP = 4  # measured on every fourth row of larger images
LEAST_ROWS = 240  # smaller images are measured whole
ISLAND_PX = 50  # largest area of an island
STEP_PX = 1.0  # a larger difference of neighbouring disparities is a step
EDGE_DN = 4.0  # least horizontal gradient of an edge of the image, per px
EDGE_REACH_PX = 2  # an edge of the image lies at most this far from the step that it explains


class DisparityAgreement(FactModel):
    """Agreement of a disparity map with the two images."""

    template: ClassVar[str] = "disparity_agreement"

    photometric_residual_dn: float | None = quantity(
        "median absolute difference of the left and the warped right image after local normalisation, valid pixels",
        unit="dn",
        ge=0,
        resolution=0.01,
        default=None,
    )
    supported_fraction: float | None = quantity(
        "share of the valid textured pixels whose windows correlate by at least 0.5",
        ge=0,
        le=1,
        resolution=1e-4,
        default=None,
    )
    unsupported_step_fraction: float | None = quantity(
        "share of the disparity steps of more than 1 px that have no edge of the image beside them",
        ge=0,
        le=1,
        resolution=1e-3,
        default=None,
    )
    island_fraction: float = quantity(
        "share of the pixels that are valid in islands of at most 50 px", ge=0, le=1, resolution=1e-4
    )


def gray_dn(image: Image) -> FloatImage:
    """Return the image as gray float32 on the 0-255 scale."""
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return gray.astype(np.float32) / np.float32(dn_scale(image))


def warp_right(right: FloatImage, disparity: FloatImage) -> tuple[FloatImage, Mask]:
    """Sample the right image at the match of every left pixel, linearly; also return where that is possible.

    Parameters
    ----------
    right : float32 (H, W)
    disparity : float32 (H, W)
        px, NaN where invalid.
    """
    rows, columns = disparity.shape
    column = np.arange(columns, dtype=np.float32) - disparity
    with np.errstate(invalid="ignore"):
        known = (column >= -0.5) & (column <= columns - 0.5)
    row = np.repeat(np.arange(rows, dtype=np.float32)[:, None], columns, axis=1)
    column = np.where(known, column, np.float32(0.0)).astype(np.float32)
    warped = cv2.remap(right, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, np.float32), known


def local_moments(values: FloatImage, known: Mask) -> tuple[FloatImage, FloatImage]:
    """Return the mean and standard deviation of the known pixels in the window around each pixel."""
    weight = known.astype(np.float32)

    def box(image: FloatImage) -> FloatImage:
        total = cv2.boxFilter(image, -1, (WINDOW_PX, WINDOW_PX), normalize=False, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(total, np.float32)

    count = np.maximum(box(weight), np.float32(1.0))
    mean = box(values * weight) / count
    variance = box(values * values * weight) / count - mean * mean
    return mean.astype(np.float32), np.sqrt(np.maximum(variance, 0.0)).astype(np.float32)


def photometric_agreement(left: Image, right: Image, disparity: FloatImage) -> tuple[float | None, float | None]:
    """Return the median normalised residual in DN and the share of supported pixels.

    The warped right image gets the mean and contrast of the left one in every window, so that gain, offset and slow
    changes of light do not count. A pixel is supported where the windows then correlate by at least 0.5; only textured
    pixels are asked.
    """
    one = gray_dn(left)
    other, known = warp_right(gray_dn(right), disparity)
    if not known.any():
        return None, None
    mean_one, std_one = local_moments(one, known)
    mean_other, std_other = local_moments(other, known)
    gain = np.clip((std_one + NOISE_DN) / (std_other + NOISE_DN), 0.25, 4.0)
    residual = float(np.median(np.abs((one - mean_one) - gain * (other - mean_other))[known]))
    product, _ = local_moments(one * other, known)
    covariance = product - mean_one * mean_other
    textured = known & (np.maximum(std_one, std_other) > 2.0 * NOISE_DN)
    if not textured.any():
        return residual, None
    correlation = covariance / np.maximum(std_one * std_other, NOISE_DN**2)
    return residual, float(np.mean(correlation[textured] >= SUPPORT_CORRELATION))


def unsupported_steps(left: Image, disparity: FloatImage) -> float | None:
    """Return the share of the steps along the rows that have no edge of the image beside them, None without steps."""
    with np.errstate(invalid="ignore"):
        step = np.abs(np.diff(disparity, axis=1)) > STEP_PX
    if not step.any():
        return None
    slope = np.abs(cv2.Sobel(gray_dn(left), cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8))
    strongest = cv2.dilate(slope, np.ones((1, 2 * EDGE_REACH_PX + 1), np.uint8))
    return float(np.mean(np.maximum(strongest[:, 1:], strongest[:, :-1])[step] < EDGE_DN))


def small_islands(disparity: FloatImage) -> int:
    """Count the valid pixels in 4-connected islands of at most 50 px whose neighbours differ by at most 1 px."""
    valid = np.isfinite(disparity)
    if not valid.any():
        return 0
    steps = min(16.0, 30000.0 / max(float(np.nanmax(np.abs(disparity))), 1.0))
    empty = -32768
    fixed = np.where(valid, np.rint(np.nan_to_num(disparity) * steps), empty).astype(np.int16)
    cv2.filterSpeckles(fixed, empty, ISLAND_PX, max(round(steps), 1))
    return int(np.count_nonzero(valid & (fixed == empty)))


def measure_disparity_agreement(state: Matching) -> list[FactModel]:
    """Compare a disparity map with the images that were matched.

    Parameters
    ----------
    state : Matching
        Views and disparity; without a disparity there is nothing to measure and the list is empty.

    Returns
    -------
    list of FactModel
        One `DisparityAgreement`.

    References
    ----------
    P. Merrell et al., Real-time visibility-based fusion of depth maps, ICCV 2007 (warped agreement as evidence).
    """
    if state.disparity is None:
        return []
    views = state.views
    rows = slice(None, None, ROW_STEP if views.shape[0] >= LEAST_ROWS else 1)
    thinned = np.ascontiguousarray(state.disparity.disparity_px[rows])
    residual, supported = photometric_agreement(views.left[rows], views.right[rows], thinned)
    return [
        DisparityAgreement(
            photometric_residual_dn=residual,
            supported_fraction=supported,
            unsupported_step_fraction=unsupported_steps(views.left[rows], thinned),
            island_fraction=small_islands(state.disparity.disparity_px) / state.disparity.disparity_px.size,
        )
    ]


PROBE = Probe(
    name="measurement.disparity_agreement",
    templates=(DisparityAgreement,),
    function=measure_disparity_agreement,
    tier="medium",
    subject="disparity",
    summary="Warps the right image by the disparity and compares it, and the steps with the edges of the image.",
    cost=Cost(fixed_ms=2, ns_per_pixel=25),
)
