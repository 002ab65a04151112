"""What it takes to warp one histogram onto the other."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from modules.measurement.sample import Sample
from modules.primitives.histogram_warping import warp_levels
from modules.probe import FactModel, Probe, quantity

BINS = 64  # of 4 dn; a finer table takes the square of the time and says the same
MAX_RUN = 8  # bins of one histogram that one of the other may take


class HistogramWarp(FactModel):
    """Dynamic warping of the left histogram onto the right one, luminance of the columns that both images see."""

    template: ClassVar[str] = "histogram_warp"

    cost: float = quantity(
        "Shares of pixels that differ along the best increasing map; 0 for equal histograms, more for uneven maps",
        ge=0,
        le=2,
        resolution=0.001,
    )
    plain_cost: float = quantity(
        "The same without warping: the sum of absolute differences of the histograms", ge=0, le=2, resolution=0.001
    )


def measure_histogram_warp(sample: Sample) -> list[HistogramWarp]:
    """Return the one `histogram_warp` fact of the pair.

    References
    ----------
    I. J. Cox, S. Roy, S. L. Hingorani, Dynamic histogram warping of image pairs for constant image brightness, ICIP
    1995.
    """
    left, right = (counts.reshape(BINS, -1).sum(axis=1) for counts in sample.common_counts["gray"])
    left, right = left / max(left.sum(), 1.0), right / max(right.sum(), 1.0)
    cost = warp_levels(left[None], right[None], MAX_RUN).costs[0]
    return [
        HistogramWarp(
            cost=float(np.clip(cost, 0, 2)),
            plain_cost=float(min(np.abs(left - right).sum(), 2.0)),
        )
    ]


PROBE = Probe(
    "measurement.histogram_warp",
    (HistogramWarp,),
    measure_histogram_warp,
    "medium",
    "pair",
    "Warps the histograms onto each other and says at what cost.",
)
