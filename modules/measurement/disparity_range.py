"""Which disparities occur."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.primitives.coarse import CoarseMatch
from modules.primitives.statistics import percentiles
from modules.probe import FactModel, Probe, quantity

PADDING_LOW = 0.22  # of the span; percentiles of features underestimate the range by 20 to 25 %
PADDING_HIGH = 0.35  # near objects are small and rarely carry features
SPARSE_PERCENT = (0.5, 99.5)  # of the sparse matches, which are seldom wrong
DENSE_PERCENT = (1.0, 99.0)  # of the coarse match, which is wrong on a few pixels
LEAST_SUPPORT = 12  # matches
NO_PARALLAX_PX = 0.5  # disparities nearer to 0 say nothing about the order of the images: one file given twice


class DisparityRangeFact(FactModel):
    """Disparities to search, and whether the images belong together in this order."""

    template: ClassVar[str] = "disparity_range"

    min_px: int | None = quantity("Smallest disparity to search", unit="px", default=None)
    max_px: int | None = quantity("End of the range to search, exclusive", unit="px", default=None)
    source: Literal["given", "estimated", "unknown"] = quantity("Where the range comes from")
    support_count: int = quantity("Sparse matches behind the range; 0 where it was given", ge=0)
    sign: Literal["positive", "negative", "mixed", "unknown"] = quantity(
        "Sign of nearly all disparities; negative: the images are probably swapped"
    )
    matched_fraction: float | None = quantity(
        "Agreeing matches over the features of the poorer image; near 0: the images do not show one scene",
        ge=0,
        le=1,
        resolution=0.001,
        default=None,
    )


def measure_disparity_range(sample: Sample) -> list[DisparityRangeFact]:
    """Return the one `disparity_range` fact of the pair.

    A range given with the pair is passed on without any matching. Otherwise the range comes from the percentiles of the
    sparse matches that lie in one row after the row fit, joined with a coarse dense match, and padded.
    """
    if sample.given_range is not None:
        low, high = sample.given_range.min_px, sample.given_range.max_px
        sign: Literal["positive", "negative", "mixed"] = "positive" if low >= 0 else "mixed"
        if high <= 1:
            sign = "negative"
        return [DisparityRangeFact(min_px=low, max_px=high, source="given", support_count=0, sign=sign)]
    features = sample.features
    agreeing = features.agreeing
    fraction = features.agreeing_fraction
    disparities = (agreeing.left_xy - agreeing.right_xy)[:, 0].astype(np.float64)
    if len(disparities) < LEAST_SUPPORT:
        return [
            DisparityRangeFact(
                source="unknown", support_count=len(disparities), sign="unknown", matched_fraction=fraction
            )
        ]
    first, last = (float(value) for value in percentiles(disparities, SPARSE_PERCENT))
    least, most = _join(first, last, sample.coarse)
    span = most - least
    lowest = int(np.floor(least - max(2.0, PADDING_LOW * span)))
    return [
        DisparityRangeFact(
            min_px=max(0, lowest) if first >= 0 else lowest,
            max_px=int(np.ceil(most + max(2.0, PADDING_HIGH * span))) + 1,
            source="estimated",
            support_count=len(disparities),
            sign=_sign(disparities),
            matched_fraction=fraction,
        )
    ]


def _sign(disparities: NDArray[np.float64]) -> Literal["positive", "negative", "mixed"]:
    """Return the sign of nearly all disparities; sky and the horizon, which have none, do not vote."""
    voting = disparities[np.abs(disparities) > NO_PARALLAX_PX]
    if len(voting) < LEAST_SUPPORT:
        return "positive" if np.mean(disparities > 0) > 0.95 else "mixed"
    positive = float(np.mean(voting > 0))
    return "positive" if positive > 0.95 else "negative" if positive < 0.05 else "mixed"


def _join(low: float, high: float, coarse: CoarseMatch | None) -> tuple[float, float]:
    if coarse is None:
        return low, high
    visible = coarse.visible()
    known = visible[np.isfinite(visible)]
    if known.size == 0:
        return low, high
    first, last = percentiles(known, DENSE_PERCENT) / coarse.factor
    return min(low, float(first)), max(high, float(last))


PROBE = Probe(
    "measurement.disparity_range",
    (DisparityRangeFact,),
    measure_disparity_range,
    "medium",
    "pair",
    "Takes the given range, or estimates it from sparse matches and a coarse dense match.",
    cost=Cost(fixed_ms=0.2, ns_per_pixel=0),
)
