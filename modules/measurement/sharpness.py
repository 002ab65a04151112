"""Whether one image is blurred."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Sample
from modules.primitives.noise import estimate_noise_dn
from modules.probe import FactModel, Probe, quantity

BLOCK_PX = 24
ENOUGH_PX = 160_000  # pixels of the middle rows that suffice
FINE_NOISE = 1 - 1 / 9  # variance of white noise that passes g - box3(g)
COARSE_NOISE = 1 / 9 - 1 / 49  # variance of white noise that passes box3(g) - box7(g)


class Sharpness(FactModel):
    """Sharpness of the right image relative to the left one."""

    template: ClassVar[str] = "sharpness"

    ratio: float = quantity(
        "Fine over coarse detail per block, free of noise, right over left; below 1: the right image is blurred",
        ge=0,
        le=100,
        resolution=0.001,
    )


def _detail(gray: NDArray[np.uint8]) -> float:
    # The middle rows suffice and keep it cheap.
    height = gray.shape[0]
    rows = min(height - 2 * (height // 3), max(2 * BLOCK_PX, ENOUGH_PX // gray.shape[1]))
    values = gray[(height - rows) // 2 : (height + rows) // 2].astype(np.float32)
    if min(values.shape) < 2 * BLOCK_PX:
        return 1.0
    noise = estimate_noise_dn(gray[height // 4 : height - height // 4]) ** 2
    box3, box7 = cv2.blur(values, (3, 3)), cv2.blur(values, (7, 7))
    size = (values.shape[1] // BLOCK_PX, values.shape[0] // BLOCK_PX)
    fine = cv2.resize((values - box3) ** 2, size, interpolation=cv2.INTER_AREA) - FINE_NOISE * noise
    coarse = cv2.resize((box3 - box7) ** 2, size, interpolation=cv2.INTER_AREA) - COARSE_NOISE * noise
    textured = coarse > max(1.0, float(np.median(coarse)), noise)
    if np.count_nonzero(textured) < 5:
        return 1.0
    # The ratio within a block does not depend on its gain: local light cancels.
    return float(np.sqrt(max(float(np.median(fine[textured] / coarse[textured])), 1e-4)))


def measure_sharpness(sample: Sample) -> list[Sharpness]:
    """Return the one `sharpness` fact of the pair."""
    left, right = (_detail(gray) for gray in sample.gray8)
    return [Sharpness(ratio=float(np.clip(right / left, 0, 100)))]


PROBE = Probe(
    "measurement.sharpness", (Sharpness,), measure_sharpness, "cheap", "pair", "Compares the fine detail of the images."
)
