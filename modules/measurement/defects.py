"""Stuck pixels and lines of the sensors."""

from __future__ import annotations

from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Gray, Sample
from modules.primitives.photometry import to_8_bit
from modules.probe import FactModel, Probe, quantity

RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
MARGIN_DN = 24  # beyond the brightest or darkest neighbour, on top of the spread of the neighbours
STEP_DN = 8  # a line differs by this from the mean of its neighbours ...
STRIP_PX = 64  # rows that are looked at together; of large images only every second or third strip is
ENOUGH_PX = 300_000  # pixels that suffice
ENOUGH_ROWS = 240  # of a column tell whether it stands out
ONE_SIDED = 0.93  # ... with one sign on nearly its whole length, which edges of a scene seldom do


class Defects(FactModel):
    """Pixels and lines that stand out from their neighbours."""

    template: ClassVar[str] = "defects"

    left_stuck_ppm: float = quantity(
        "Lone pixels far outside of their neighbours, left, per million", ge=0, resolution=1.0
    )
    right_stuck_ppm: float = quantity("The same of the right image, per million", ge=0, resolution=1.0)
    stuck_difference_ppm: float = quantity(
        "Absolute difference of the two; glints lie in both images, defects in one", ge=0, resolution=1.0
    )
    left_lines: int = quantity("Rows and columns of one sign against both neighbours, left", ge=0)
    right_lines: int = quantity("The same of the right image", ge=0)
    lines_difference: int = quantity("Absolute difference of the two", ge=0)


def measure_defects(sample: Sample) -> list[Defects]:
    """Return the one `defects` fact of the pair."""
    stuck = [_stuck_ppm(to_8_bit(image)) for image in (sample.views.left, sample.views.right)]
    lines = [_lines(gray) + _lines(gray.T) for gray in sample.gray8]
    return [
        Defects(
            left_stuck_ppm=stuck[0],
            right_stuck_ppm=stuck[1],
            stuck_difference_ppm=abs(stuck[0] - stuck[1]),
            left_lines=lines[0],
            right_lines=lines[1],
            lines_difference=abs(lines[0] - lines[1]),
        )
    ]


def _stuck_ppm(image: NDArray[np.uint8]) -> float:
    rows, columns = image.shape[:2]
    step = STRIP_PX * max(1, rows * columns // ENOUGH_PX)
    strips = [image] if step == STRIP_PX else [image[row : row + STRIP_PX] for row in range(0, rows, step)]
    return 1e6 * sum(map(_stuck, strips)) / sum(strip.shape[0] * columns for strip in strips)


def _stuck(image: NDArray[np.uint8]) -> int:
    """Return the number of pixels with a channel far outside of its neighbours."""
    planes: list[Any] = [image] if image.ndim == 2 else list(cv2.split(image))
    found = np.zeros(planes[0].shape, np.uint8)
    for plane in planes:
        brightest, darkest = cv2.dilate(plane, RING), cv2.erode(plane, RING)
        beyond = cv2.max(cv2.subtract(plane, brightest), cv2.subtract(darkest, plane))
        spread = cv2.subtract(brightest, darkest)
        found = cv2.max(found, cv2.subtract(beyond, spread))
    return int(np.count_nonzero(found > MARGIN_DN))


def _lines(gray: Gray) -> int:
    if gray.shape[1] < 3:
        return 0
    values = np.ascontiguousarray(gray[:: max(1, gray.shape[0] // ENOUGH_ROWS)])
    twice = np.asarray(cv2.sepFilter2D(values, cv2.CV_16S, np.array([-1.0, 2.0, -1.0]), np.ones(1)))[:, 1:-1]
    signs = [np.asarray(sign, np.uint8) for sign in (twice > 2 * STEP_DN, twice < -2 * STEP_DN)]
    shares = [cv2.reduce(sign, 0, cv2.REDUCE_AVG, dtype=cv2.CV_32F).ravel() for sign in signs]
    found = np.concatenate([[False], np.abs(shares[0] - shares[1]) > ONE_SIDED])
    return int(np.count_nonzero(found[1:] & ~found[:-1]))  # the neighbours of a line stand out from it, too


PROBE = Probe(
    "measurement.defects",
    (Defects,),
    measure_defects,
    "medium",
    "pair",
    "Counts stuck pixels and lines of the sensors.",
)
