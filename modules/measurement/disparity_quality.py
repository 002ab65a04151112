"""Measure the quality of a disparity map without a reference."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.agreement import gather_evidence
from modules.primitives.confidence import predict_confidence
from modules.probe import FactModel, Probe, quantity
from modules.types import Disparity, DisparityRange, FloatImage, Image, Invalid, Mask, Matching, dn_scale

WINDOW_PX = 9  # window of the local normalisation
SPECKLE_PX = 50  # largest area of an island counted as speckle
NOISE_DN = 2.0  # local contrast below this is noise
BORDER_PX = 1.0  # distance to an end of the range that counts as its border
SUPPORT_CORRELATION = 0.5  # least local correlation of a pixel whose match is supported by the images
ROW_STEP = 4  # the agreement with the images is measured on every fourth row of larger images
LEAST_ROWS = 240  # smaller images are measured whole
STEP_PX = 1.0  # a larger difference of neighbouring disparities is a step
EDGE_DN = 4.0  # least horizontal gradient of an edge of the image, per px
EDGE_REACH_PX = 2  # an edge of the image lies at most this far from the step that it explains
SIGN_WIDTH_PX = 240  # width of the reduced pair on which the sign is tested
SIGN_DENSITY = 0.5  # the sign is tested only below this density
SIGN_RATIO = 2.0  # suspect when the opposite sign matches this many times more pixels


class DisparityQuality(FactModel):
    """Quality of a disparity map, from the map and the two images alone."""

    template: ClassVar[str] = "disparity_quality"

    density_fraction: float = quantity("share of the usable pixels that have a disparity", ge=0, le=1, resolution=1e-4)
    left_right_rejected_fraction: float = quantity(
        "share of the usable pixels rejected by the left-right check", ge=0, le=1, resolution=1e-4
    )
    not_unique_fraction: float = quantity(
        "share of the usable pixels rejected as not unique", ge=0, le=1, resolution=1e-4
    )
    range_border_fraction: float = quantity(
        "share of the usable pixels within 1 px of an end of the searched range, or rejected for it",
        ge=0,
        le=1,
        resolution=1e-4,
    )
    lower_border_fraction: float = quantity(
        "share of the usable pixels with a disparity within 1 px of the lower end of the range",
        ge=0,
        le=1,
        resolution=1e-4,
    )
    upper_border_fraction: float = quantity(
        "share of the usable pixels with a disparity within 1 px of the upper end of the range",
        ge=0,
        le=1,
        resolution=1e-4,
    )
    speckle_fraction: float = quantity(
        "share of the usable pixels rejected as speckle or valid in islands of at most 50 px",
        ge=0,
        le=1,
        resolution=1e-4,
    )
    outside_fraction: float = quantity(
        "share of the usable pixels whose match would lie outside the right image", ge=0, le=1, resolution=1e-4
    )
    low_confidence_fraction: float = quantity(
        "share of the usable pixels rejected because they are hardly likely to be right", ge=0, le=1, resolution=1e-4
    )
    unsuitable_fraction: float = quantity(
        "share of the usable pixels rejected as textureless, saturated or of a flat minimum",
        ge=0,
        le=1,
        resolution=1e-4,
    )
    no_match_fraction: float = quantity(
        "share of the usable pixels for which the matcher gave nothing", ge=0, le=1, resolution=1e-4
    )
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
    confidence_mean: float = quantity(
        "mean probability of the valid pixels to be right within 1 px; 0 where none is valid",
        ge=0,
        le=1,
        resolution=1e-4,
    )
    confidence_low_decile: float = quantity(
        "confidence that a tenth of the valid pixels stays below; 0 where none is valid", ge=0, le=1, resolution=1e-3
    )
    sign_suspect: bool = quantity("few pixels match, and many more with disparities of the opposite sign")
    score: float = quantity(
        "no-reference score: expected share of the usable pixels that have a disparity right within 1 px",
        ge=0,
        le=1,
        resolution=1e-4,
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


def confidence_of(state: Matching, disparity: Disparity) -> FloatImage:
    """Return the confidence that an operator has predicted, or predict it."""
    if disparity.confidence is not None:
        return disparity.confidence
    return predict_confidence(gather_evidence(state.views.left, state.views.right, disparity))


def small_islands(disparity: FloatImage) -> int:
    """Count the valid pixels in 4-connected islands of at most 50 px whose neighbours differ by at most 1 px."""
    valid = np.isfinite(disparity)
    if not valid.any():
        return 0
    steps = min(16.0, 30000.0 / max(float(np.nanmax(np.abs(disparity))), 1.0))
    empty = -32768
    fixed = np.where(valid, np.rint(np.nan_to_num(disparity) * steps), empty).astype(np.int16)
    cv2.filterSpeckles(fixed, empty, SPECKLE_PX, max(round(steps), 1))
    return int(np.count_nonzero(valid & (fixed == empty)))


def matched_pixels(left: NDArray[np.uint8], right: NDArray[np.uint8], search: DisparityRange) -> float:
    """Count the pixels of a reduced pair that match uniquely, match back, and correlate with their match."""
    count = -(-search.count // 16) * 16
    pad = count + abs(search.min_px)
    one, other = (cv2.copyMakeBorder(image, 0, 0, pad, pad, cv2.BORDER_REPLICATE) for image in (left, right))
    matcher = cv2.StereoSGBM.create(
        search.min_px, count, 5, 8 * 25, 32 * 25, 1, 63, 15, 50, 2, cv2.STEREO_SGBM_MODE_SGBM_3WAY
    )
    fixed = np.asarray(matcher.compute(one, other))[:, pad:-pad]
    disparity = fixed.astype(np.float32) / np.float32(16.0)
    disparity[fixed < search.min_px * 16] = np.nan
    _, supported = photometric_agreement(left, right, disparity)
    return int(np.count_nonzero(np.isfinite(disparity))) * (supported or 0.0)


def opposite_sign_matches(left: Image, right: Image, search: DisparityRange) -> bool:
    """Return whether a reduced pair matches far better with disparities of the opposite sign."""
    if search.min_px < 0 < search.max_px - 1 and -search.min_px > search.max_px // 2:
        return False  # both signs have been searched already
    reduction = min(1.0, SIGN_WIDTH_PX / left.shape[1])
    size = (max(round(left.shape[1] * reduction), 16), max(round(left.shape[0] * reduction), 16))
    images = [
        np.clip(cv2.resize(gray_dn(image), size, interpolation=cv2.INTER_AREA), 0, 255).astype(np.uint8)
        for image in (left, right)
    ]
    low, high = int(np.floor(search.min_px * reduction)), int(np.ceil(search.max_px * reduction))
    if high - low < 1 or high - low > size[0]:
        return False
    straight = matched_pixels(images[0], images[1], DisparityRange(low, high))
    opposite = matched_pixels(images[0], images[1], DisparityRange(1 - high, 1 - low))
    return opposite > SIGN_RATIO * straight and opposite > 0.2 * size[0] * size[1]


def measure_disparity_quality(state: Matching) -> list[FactModel]:
    """Measure a disparity map.

    Parameters
    ----------
    state : Matching
        Views, range and disparity; without a disparity there is nothing to measure and the list is empty.

    Returns
    -------
    list of FactModel
        One `DisparityQuality`. Shares are of the pixels that the left mask allows.

    Notes
    -----
    The score is the expected share of the usable pixels that have a disparity right within 1 px: the sum of the
    confidence over the valid pixels. It orders trials of one pair, whatever matcher made them
    (`benchmarks/quality_score.py`).

    References
    ----------
    P. Merrell et al., Real-time visibility-based fusion of depth maps, ICCV 2007 (warped agreement as evidence).
    """
    disparity = state.disparity
    if disparity is None:
        return []
    views = state.views
    usable = np.ones(views.shape, bool) if views.left_mask is None else views.left_mask
    total = max(int(np.count_nonzero(usable)), 1)
    valid = disparity.valid & usable

    def share(where: Mask) -> float:
        return int(np.count_nonzero(where & usable)) / total

    counts = np.bincount(disparity.validity[usable])
    flags = np.arange(len(counts))

    def rejected(reason: Invalid) -> float:
        return int(counts[(flags & int(reason)) != 0].sum()) / total

    lower, upper = ends_of_range(disparity, state.range_px)
    speckle = min(rejected(Invalid.SPECKLE) + small_islands(disparity.disparity_px) / total, 1.0)
    rows = slice(None, None, ROW_STEP if views.shape[0] >= LEAST_ROWS else 1)
    thinned = np.ascontiguousarray(disparity.disparity_px[rows])
    residual, supported = photometric_agreement(views.left[rows], views.right[rows], thinned)
    density = share(valid)
    suspect = (
        state.range_px is not None
        and density < SIGN_DENSITY
        and opposite_sign_matches(views.left, views.right, state.range_px)
    )
    confidence = np.clip(confidence_of(state, disparity)[valid], 0.0, 1.0)
    expected = float(np.sum(confidence, dtype=np.float64))
    decile = float(np.partition(confidence, confidence.size // 10)[confidence.size // 10]) if confidence.size else 0.0
    return [
        DisparityQuality(
            density_fraction=density,
            left_right_rejected_fraction=rejected(Invalid.LEFT_RIGHT),
            not_unique_fraction=rejected(Invalid.NOT_UNIQUE),
            range_border_fraction=min(share(lower | upper) + rejected(Invalid.RANGE_BORDER), 1.0),
            lower_border_fraction=share(lower),
            upper_border_fraction=share(upper),
            speckle_fraction=speckle,
            outside_fraction=rejected(Invalid.OUTSIDE),
            low_confidence_fraction=rejected(Invalid.LOW_CONFIDENCE),
            unsuitable_fraction=rejected(Invalid.TEXTURELESS | Invalid.SATURATED | Invalid.FLAT_MINIMUM),
            no_match_fraction=rejected(Invalid.NO_MATCH),
            photometric_residual_dn=residual,
            supported_fraction=supported,
            unsupported_step_fraction=unsupported_steps(views.left[rows], thinned),
            confidence_mean=expected / max(confidence.size, 1),
            confidence_low_decile=decile,
            sign_suspect=suspect,
            score=min(expected / total, 1.0),
        )
    ]


def ends_of_range(disparity: Disparity, search: DisparityRange | None) -> tuple[Mask, Mask]:
    """Return the pixels whose disparity is within 1 px of the lower and of the upper end of the range."""
    if search is None:
        nowhere = np.zeros(disparity.disparity_px.shape, bool)
        return nowhere, nowhere
    with np.errstate(invalid="ignore"):
        lower: Mask = disparity.disparity_px <= search.min_px + BORDER_PX
        upper: Mask = disparity.disparity_px >= search.max_px - 1 - BORDER_PX
    return lower, upper


PROBE = Probe(
    name="measurement.disparity_quality",
    templates=(DisparityQuality,),
    function=measure_disparity_quality,
    tier="medium",
    subject="disparity",
    summary="Measure density, rejections by reason, photometric agreement and a no-reference score of a disparity map.",
)
