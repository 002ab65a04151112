"""Measure the quality of a disparity map without a reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.disparity_agreement import gray_dn, photometric_agreement
from modules.operator import Cost
from modules.primitives.coarse import sixteens
from modules.probe import FactModel, Probe, quantity
from modules.types import Disparity, DisparityRange, FloatImage, Image, Invalid, Mask, Matching

DECILE_STEP = 8  # every so many pixels suffice for the low decile of the confidence
BORDER_PX = 1.0  # distance to an end of the range that counts as its border
SIGN_WIDTH_PX = 240  # width of the reduced pair on which the sign is tested
SIGN_DENSITY = 0.5  # the sign is tested only below this density
SIGN_RATIO = 2.0  # suspect when the opposite sign matches this many times more pixels


class DisparityQuality(FactModel):
    """Quality of a disparity map, from the map and the two images alone."""

    template: ClassVar[str] = "disparity_quality"

    usable_fraction: float = quantity(
        "share of the pixels that no mask excludes", ge=0, le=1, resolution=1e-4, default=1.0
    )
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
    speckle_fraction: float = quantity("share of the usable pixels rejected as speckle", ge=0, le=1, resolution=1e-4)
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
    confidence_mean: float | None = quantity(
        "mean probability of the valid pixels to be right within 1 px; 0 where none is valid, absent where it was not "
        "estimated",
        ge=0,
        le=1,
        resolution=1e-4,
        default=None,
    )
    confidence_low_decile: float | None = quantity(
        "confidence that a tenth of the valid pixels stays below; as `confidence_mean`",
        ge=0,
        le=1,
        resolution=1e-3,
        default=None,
    )
    sign_suspect: bool = quantity("few pixels match, and many more with disparities of the opposite sign")
    score: float | None = quantity(
        "no-reference score: predicted share of the usable pixels that have a disparity right within 1 px; absent "
        "where the confidence was not estimated",
        ge=0,
        le=1,
        resolution=1e-4,
        default=None,
    )


def matched_pixels(left: NDArray[np.uint8], right: NDArray[np.uint8], search: DisparityRange) -> float:
    """Count the pixels of a reduced pair that match uniquely, match back, and correlate with their match."""
    count = sixteens(search.count)
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
    The score is the merit that the confidence was estimated with (`modules.primitives.merit`). It orders trials of one
    pair, whatever matcher made them and whatever corrections it was given (`benchmarks/quality_score.py`).
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

    counts = np.bincount(disparity.validity[usable & (disparity.validity != 0)])
    flags = np.arange(len(counts))

    def rejected(reason: Invalid) -> float:
        return int(counts[(flags & int(reason)) != 0].sum()) / total

    lower, upper = ends_of_range(disparity, state.range_px)
    density = share(valid)
    suspect = (
        state.range_px is not None
        and density < SIGN_DENSITY
        and opposite_sign_matches(views.left, views.right, state.range_px)
    )
    trust = _Trust() if disparity.confidence is None else _trust(disparity.confidence[valid])
    return [
        DisparityQuality(
            usable_fraction=np.count_nonzero(usable) / usable.size,
            density_fraction=density,
            left_right_rejected_fraction=rejected(Invalid.LEFT_RIGHT),
            not_unique_fraction=rejected(Invalid.NOT_UNIQUE),
            range_border_fraction=min(share(lower | upper) + rejected(Invalid.RANGE_BORDER), 1.0),
            lower_border_fraction=share(lower),
            upper_border_fraction=share(upper),
            speckle_fraction=rejected(Invalid.SPECKLE),
            outside_fraction=rejected(Invalid.OUTSIDE),
            low_confidence_fraction=rejected(Invalid.LOW_CONFIDENCE),
            unsuitable_fraction=rejected(Invalid.TEXTURELESS | Invalid.SATURATED | Invalid.FLAT_MINIMUM),
            no_match_fraction=rejected(Invalid.NO_MATCH),
            confidence_mean=trust.mean,
            confidence_low_decile=trust.low_decile,
            sign_suspect=suspect,
            score=disparity.merit,
        )
    ]


@dataclass(frozen=True)
class _Trust:
    """What the confidence says of a map; None where there is none."""

    mean: float | None = None
    low_decile: float | None = None


def _trust(confidence: FloatImage) -> _Trust:
    """Sum up the confidence of the valid pixels (N,)."""
    values = np.clip(confidence, 0.0, 1.0)
    expected = cv2.sumElems(values)[0]
    some = values[::DECILE_STEP]
    decile = float(np.partition(some, some.size // 10)[some.size // 10]) if some.size else 0.0
    return _Trust(expected / max(values.size, 1), decile)


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
    tier="cheap",
    subject="disparity",
    summary="Counts what was matched and rejected, and why, and sums up the confidence; has the no-reference score.",
    cost=Cost(fixed_ms=1, ns_per_pixel=25),
)
