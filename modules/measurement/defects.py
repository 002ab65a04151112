"""Stuck pixels and lines of the sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.primitives.photometry import to_8_bit
from modules.primitives.stuck import stand_out
from modules.probe import FactModel, Probe, quantity

Image8 = NDArray[np.uint8]

MARGIN_DN = 24  # beyond the brightest or darkest neighbour, on top of the spread of the neighbours
LEAST_CONTRAST_DN = 1.0  # mean spread of neighbours, below which contrasts are not compared
MOST_CONTRAST = 3.0  # times the contrast of the other image, beyond which the limit does not follow
STRIP_PX = 64  # rows that are looked at together; of large images only every second or third strip is
ENOUGH_PX = 300_000  # pixels that suffice


class Defects(FactModel):
    """Pixels and lines that stand out from their neighbours."""

    template: ClassVar[str] = "defects"

    left_stuck_ppm: float = quantity(
        "Lone pixels far outside of their neighbours, left, per million of those not beside clipped ones",
        ge=0,
        resolution=1.0,
    )
    right_stuck_ppm: float = quantity("The same of the right image, per million", ge=0, resolution=1.0)
    stuck_difference_ppm: float = quantity(
        "Absolute difference of the two; glints lie in both images, defects in one", ge=0, resolution=1.0
    )
    left_lines: int = quantity("Rows and columns of one sign against both neighbours, left", ge=0)
    right_lines: int = quantity("The same of the right image", ge=0)
    lines_difference: int = quantity("Absolute difference of the two", ge=0)


def measure_defects(sample: Sample) -> list[Defects]:
    """Return the one `defects` fact of the pair.

    The limit beyond which a pixel is stuck follows the contrast of the image: what a higher gain makes of glints and
    grain is no defect.
    """
    images = [to_8_bit(image) for image in (sample.views.left, sample.views.right)]
    found = [[_look(strip) for strip in _strips(image)] for image in images]
    contrast = [float(np.mean([look.spread_dn for look in looks])) for looks in found]
    least = max(min(contrast), LEAST_CONTRAST_DN)
    stuck = [
        _stuck_ppm(looks, MARGIN_DN * float(np.clip(own / least, 1, MOST_CONTRAST)))
        for looks, own in zip(found, contrast, strict=True)
    ]
    lines = [rows.size + columns.size for rows, columns in sample.lines]
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


@dataclass(frozen=True)
class _Look:
    """Pixels of a strip: by how much each stands out by more than its neighbours spread, in its oddest channel.

    `spread_dn` is the mean spread of the neighbours, `usable` the number of pixels beside which nothing is clipped.
    """

    excess_dn: Image8
    spread_dn: float
    usable: int


def _strips(image: Image8) -> list[Image8]:
    rows, columns = image.shape[:2]
    step = STRIP_PX * max(1, rows * columns // ENOUGH_PX)
    return [image] if step == STRIP_PX else [image[row : row + STRIP_PX] for row in range(0, rows, step)]


def _look(strip: Image8) -> _Look:
    planes: list[Any] = [strip] if strip.ndim == 2 else list(cv2.split(strip))
    excess, usable = np.zeros(planes[0].shape, np.uint8), np.zeros(planes[0].shape, bool)
    spread_dn = []
    for plane in planes:
        look = stand_out(plane)
        excess = np.asarray(cv2.max(excess, cv2.subtract(look.beyond_dn, look.spread_dn)))
        usable |= look.usable
        spread_dn.append(cv2.mean(look.spread_dn)[0])
    return _Look(excess, max(spread_dn), int(np.count_nonzero(usable)))


def _stuck_ppm(looks: list[_Look], margin_dn: float) -> float:
    count = sum(int(np.count_nonzero(look.excess_dn > int(margin_dn))) for look in looks)
    return 1e6 * count / max(1, sum(look.usable for look in looks))


PROBE = Probe(
    "measurement.defects",
    (Defects,),
    measure_defects,
    "medium",
    "pair",
    "Counts stuck pixels and lines of the sensors.",
    cost=Cost(fixed_ms=1.2, ns_per_pixel=4),
)
