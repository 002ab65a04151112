"""How far the pair is from constant image brightness, from what both images see."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.primitives.statistics import (
    fit_gain_offset,
    match_levels,
    median,
    quantiles,
    wasserstein_1,
)
from modules.probe import FactModel, Probe, quantity

PROBABILITIES = np.linspace(0.02, 0.98, 49)


class Brightness(FactModel):
    """Differences of brightness between the images, on the columns that both see."""

    template: ClassVar[str] = "brightness"

    gain: float = quantity(
        "Gain of the right image relative to the left one", ge=0, resolution=0.001, sigma="gain_sigma"
    )
    gain_sigma: float = quantity("Standard error of the gain from the fit of the quantiles", ge=0, resolution=0.0001)
    offset_dn: float = quantity("Right image minus gain times left image", unit="dn", resolution=0.01)
    mean_difference_dn: float = quantity(
        "Mean of the right image minus mean of the left one", unit="dn", ge=-255, le=255, resolution=0.01
    )
    residual_after_monotone_map_dn: float = quantity(
        "Median difference of coarse blocks after matching the histograms; what a global map cannot remove, "
        "and some parallax",
        unit="dn",
        ge=0,
        le=255,
        resolution=0.01,
    )
    residual_after_gain_offset_dn: float = quantity(
        "Median difference of coarse blocks after undoing gain and offset", unit="dn", ge=0, le=255, resolution=0.01
    )
    histogram_distance_dn: float = quantity(
        "Wasserstein-1 distance of the histograms", unit="dn", ge=0, le=255, resolution=0.01
    )
    channel_spread_dn: float = quantity(
        "Largest minus smallest mean difference of a colour channel after one map for all; a colour cast",
        unit="dn",
        ge=0,
        le=510,
        resolution=0.01,
    )


def measure_brightness(sample: Sample) -> list[Brightness]:
    """Return the one `brightness` fact of the pair.

    Gain and offset come from the quantile functions of what both images see, without correspondences: a difference that
    varies over the image shows up in the residuals only.
    """
    counts = sample.common_counts["gray"]
    left_q, right_q = (quantiles(side, PROBABILITIES) for side in counts)
    gain, offset, sigma = fit_gain_offset(left_q, right_q, 255)
    gain = max(gain, 0.0)
    table = match_levels(counts[0], counts[1])
    levels = np.arange(256, dtype=np.float64)
    means = [float(side @ levels / side.sum()) for side in counts]
    return [
        Brightness(
            gain=gain,
            gain_sigma=sigma,
            offset_dn=offset,
            mean_difference_dn=means[1] - means[0],
            residual_after_monotone_map_dn=_block_difference(sample, table),
            residual_after_gain_offset_dn=_block_difference(sample, np.clip(gain * levels + offset, 0, 255)),
            histogram_distance_dn=wasserstein_1(counts[0], counts[1]),
            channel_spread_dn=_channel_spread(sample, table),
        )
    ]


def _block_difference(sample: Sample, table: NDArray[np.float64]) -> float:
    """Median absolute difference of 12 x 6 block means, after mapping the left image by `table`."""
    left, right = sample.common_quarter
    mapped = np.asarray(cv2.LUT(left, table.astype(np.float32)), np.float32).reshape(left.shape)
    a, b = (cv2.resize(x, (6, 12), interpolation=cv2.INTER_AREA) for x in (mapped, right.astype(np.float32)))
    return median(np.abs(a - b).ravel())


def _channel_spread(sample: Sample, table: NDArray[np.float64]) -> float:
    differences = []
    levels = np.arange(256)
    for name, (left, right) in sample.common_counts.items():
        if name != "gray":
            differences.append(float(right @ levels / right.sum()) - float(left @ table / left.sum()))
    return max(differences) - min(differences) if differences else 0.0


PROBE = Probe(
    "measurement.brightness",
    (Brightness,),
    measure_brightness,
    "cheap",
    "pair",
    "Fits gain and offset to the histograms of what both images see, and measures what they leave.",
    cost=Cost(fixed_ms=0.9, ns_per_pixel=1.5),
)
