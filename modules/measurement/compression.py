"""Blocks that lossy compression leaves."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np

from modules.measurement.sample import Gray, Sample
from modules.operator import Cost
from modules.primitives.statistics import median
from modules.probe import FactModel, Probe, quantity

BLOCK_PX = 8  # of JPEG and MPEG
OUTLIER = 4.0  # columns with steps beyond this times the median are edges of the scene


class Compression(FactModel):
    """Steps at a grid of 8 px over steps elsewhere; 1 without compression."""

    template: ClassVar[str] = "compression"

    left_blockiness: float = quantity("Of the left image, the lesser of rows and columns", ge=0, resolution=0.001)
    right_blockiness: float = quantity("Of the right image", ge=0, resolution=0.001)


def measure_compression(sample: Sample) -> list[Compression]:
    """Return the one `compression` fact of the pair; the grid may begin anywhere, as in a cropped image.

    References
    ----------
    Z. Wang, A. C. Bovik, B. L. Evan, Blind measurement of blocking artifacts in images, ICIP 2000.
    """
    left, right = (min(_steps(gray), _steps(np.ascontiguousarray(gray.T))) for gray in sample.gray8)
    return [Compression(left_blockiness=left, right_blockiness=right)]


def _steps(gray: Gray) -> float:
    """Return the mean step between columns at the strongest of the 8 phases over the median phase."""
    if gray.shape[1] < 4 * BLOCK_PX:
        return 1.0
    step = cv2.absdiff(gray[:, 1:], gray[:, :-1])
    means = cv2.reduce(step, 0, cv2.REDUCE_AVG, dtype=cv2.CV_32F).ravel()
    means = np.minimum(means, OUTLIER * median(means))
    phases = means[: len(means) // BLOCK_PX * BLOCK_PX].reshape(-1, BLOCK_PX).mean(axis=0)
    usual = median(phases)
    return float(phases.max() / usual) if usual > 0 else 1.0


PROBE = Probe(
    "measurement.compression",
    (Compression,),
    measure_compression,
    "medium",
    "pair",
    "Measures the blocks of lossy compression.",
    cost=Cost(fixed_ms=0.5, ns_per_pixel=2.5),
)
