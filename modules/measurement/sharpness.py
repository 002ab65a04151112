"""Whether one image is blurred."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.primitives.statistics import median
from modules.probe import FactModel, Probe, quantity

BLOCK_PX = 24
ENOUGH_PX = 160_000  # pixels of the middle rows that suffice
FINE_NOISE = 1 - 1 / 9  # variance of white noise that passes g - box3(g)
COARSE_NOISE = 1 / 9 - 1 / 49  # variance of white noise that passes box3(g) - box7(g)


class Sharpness(FactModel):
    """Sharpness of the right image relative to the left one."""

    template: ClassVar[str] = "sharpness"

    ratio: float = quantity(
        "Fine over coarse detail per block, free of noise, right over left; below 1: the right image is blurred. "
        "1 where either image has too little texture beyond its noise",
        ge=0,
        le=100,
        resolution=0.001,
    )


def _detail(gray: NDArray[np.uint8], noise_dn: float) -> float | None:
    """Return fine over coarse detail of the textured blocks; None with fewer than 5 of them."""
    # The middle rows suffice and keep it cheap.
    height = gray.shape[0]
    rows = min(height - 2 * (height // 3), max(2 * BLOCK_PX, ENOUGH_PX // gray.shape[1]))
    values = gray[(height - rows) // 2 : (height + rows) // 2]
    if min(values.shape) < 2 * BLOCK_PX:
        return None
    noise = noise_dn**2
    box3, box7 = (np.asarray(cv2.boxFilter(values, cv2.CV_32F, (side, side))) for side in (3, 7))
    fine = _block_squares(np.subtract(values, box3, dtype=np.float32)) - FINE_NOISE * noise
    coarse = _block_squares(box3 - box7) - COARSE_NOISE * noise
    textured = coarse > max(1.0, median(coarse.ravel()), noise)
    if np.count_nonzero(textured) < 5:
        return None
    # The ratio within a block does not depend on its gain: local light cancels.
    return float(np.sqrt(max(median(fine[textured] / coarse[textured]), 1e-4)))


def _block_squares(values: NDArray[np.float32]) -> NDArray[np.float32]:
    size = (values.shape[1] // BLOCK_PX, values.shape[0] // BLOCK_PX)
    whole = values[: size[1] * BLOCK_PX, : size[0] * BLOCK_PX]
    return np.asarray(cv2.resize(whole * whole, size, interpolation=cv2.INTER_AREA), np.float32)


def measure_sharpness(sample: Sample) -> list[Sharpness]:
    """Return the one `sharpness` fact of the pair."""
    left, right = (_detail(gray, noise_dn) for gray, noise_dn in zip(sample.gray8, sample.middle_noise_dn, strict=True))
    if left is None or right is None:
        return [Sharpness(ratio=1.0)]
    return [Sharpness(ratio=float(np.clip(right / left, 0, 100)))]


PROBE = Probe(
    "measurement.sharpness",
    (Sharpness,),
    measure_sharpness,
    "cheap",
    "pair",
    "Compares the fine detail of the images.",
    cost=Cost(fixed_ms=1.0, ns_per_pixel=2),
)
