"""How much of the images is clipped."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.primitives.photometry import common_view
from modules.probe import FactModel, Probe, quantity

HIGH_DN = 254  # lossy compression blurs 255 by a level
LOW_DN = 1


def _fraction(description: str) -> float:
    value: float = quantity(description, ge=0, le=1, resolution=0.0001)
    return value


class Saturation(FactModel):
    """Fractions of pixels at the ends of the scale, on the columns that both images see."""

    template: ClassVar[str] = "saturation"

    left_fraction: float = _fraction("Pixels of the left image with a channel of at least 254 dn")
    right_fraction: float = _fraction("Pixels of the right image with a channel of at least 254 dn")
    difference_fraction: float = _fraction("Absolute difference of the two fractions")
    dark_left_fraction: float = _fraction("Pixels of the left image with all channels at most 1 dn")
    dark_right_fraction: float = _fraction("Pixels of the right image with all channels at most 1 dn")
    dark_difference_fraction: float = _fraction("Absolute difference of the two dark fractions")


def measure_saturation(sample: Sample) -> list[Saturation]:
    """Return the one `saturation` fact of the pair, from every few rows.

    Scenes can be clipped in both images alike; only the difference tells that the images disagree.
    """
    images = common_view(*sample.rows, sample.shift_px)
    bright = [1 - _share_up_to(HIGH_DN - 1, image) for image in images]
    dark = [_share_up_to(LOW_DN, image) for image in images]
    return [
        Saturation(
            left_fraction=bright[0],
            right_fraction=bright[1],
            difference_fraction=abs(bright[0] - bright[1]),
            dark_left_fraction=dark[0],
            dark_right_fraction=dark[1],
            dark_difference_fraction=abs(dark[0] - dark[1]),
        )
    ]


def _share_up_to(level_dn: int, image: NDArray[np.uint8]) -> float:
    """Return the fraction of pixels with no channel above a level."""
    return cv2.countNonZero(cv2.inRange(image, (0.0,) * 4, (float(level_dn),) * 4)) / (image.shape[0] * image.shape[1])


PROBE = Probe(
    "measurement.saturation",
    (Saturation,),
    measure_saturation,
    "cheap",
    "pair",
    "Counts clipped and black pixels.",
    cost=Cost(fixed_ms=0.2, ns_per_pixel=1),
)
