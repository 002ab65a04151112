"""How corresponding pixels differ."""

from __future__ import annotations

from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Sample
from modules.primitives.statistics import count_levels, fit_gain_offset, match_levels, quantiles, robust_sigma
from modules.probe import FactModel, Probe, quantity

PROBABILITIES = np.linspace(0.02, 0.98, 49)
WINDOW_PX = 9  # of the thumbnail, over which corresponding pixels are averaged
LOG_FLOOR_DN = 4.0  # added before logarithms; darker pixels say little about gain


class Radiometry(FactModel):
    """Differences of corresponding pixels after a coarse match; only the count without a match."""

    template: ClassVar[str] = "radiometry"

    count: int = quantity("Corresponding thumbnail pixels", ge=0)
    gain: float | None = quantity(
        "Gain of the right image relative to the left one", ge=0, resolution=0.001, default=None
    )
    offset_dn: float | None = quantity(
        "Right image minus gain times left image", unit="dn", resolution=0.01, default=None
    )
    log_ratio_spread: float | None = quantity(
        "Robust standard deviation of the local log ratio; large where light differs over the image",
        ge=0,
        resolution=0.001,
        default=None,
    )
    monotone_residual_dn: float | None = quantity(
        "Robust standard deviation of the local difference after one increasing map",
        unit="dn",
        ge=0,
        resolution=0.01,
        default=None,
    )


def measure_radiometry(sample: Sample) -> list[Radiometry]:
    """Return the one `radiometry` fact of the pair.

    Notes
    -----
    The log ratio and the monotone residual are taken on 9x9 means of the thumbnail, so that noise, small errors of the
    match and texture cancel.
    """
    match = sample.coarse
    if match is None:
        return [Radiometry(count=0)]
    height, width = match.left.shape
    valid = np.isfinite(match.disparity_px)
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    columns = u - np.where(valid, match.disparity_px, np.float32(0))
    seen = np.asarray(cv2.remap(match.right, columns, v, cv2.INTER_LINEAR), dtype=np.uint8)
    pairs = [count_levels(image[valid]) for image in (match.left, seen)]
    gain, offset, _ = fit_gain_offset(quantiles(pairs[0], PROBABILITIES), quantiles(pairs[1], PROBABILITIES), 255)
    table = match_levels(pairs[0], pairs[1])
    left = match.left.astype(np.float32)
    right = seen.astype(np.float32)
    mapped = table.astype(np.float32)[match.left]
    weight = cv2.blur(valid.astype(np.float32), (WINDOW_PX, WINDOW_PX))
    local = [_mean(image, valid, weight) for image in (left, right, mapped)]
    use = (weight > 0.5) & valid
    if not use.any():
        return [Radiometry(count=0)]
    log_ratio = np.log((local[1][use] + LOG_FLOOR_DN) / (local[0][use] + LOG_FLOOR_DN))
    return [
        Radiometry(
            count=int(np.count_nonzero(valid)),
            gain=max(gain, 0.0),
            offset_dn=offset,
            log_ratio_spread=robust_sigma(log_ratio),
            monotone_residual_dn=robust_sigma(local[1][use] - local[2][use]),
        )
    ]


def _mean(image: NDArray[Any], valid: NDArray[np.bool_], weight: NDArray[Any]) -> NDArray[np.float32]:
    total = cv2.blur(np.where(valid, image, np.float32(0)), (WINDOW_PX, WINDOW_PX))
    return np.asarray(total / np.maximum(weight, np.float32(1e-3)))


PROBE = Probe(
    "measurement.radiometry",
    (Radiometry,),
    measure_radiometry,
    "dear",
    "pair",
    "Matches thumbnails densely and compares corresponding pixels.",
)
