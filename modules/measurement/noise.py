"""Noise of both images."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Sample
from modules.primitives.photometry import to_8_bit
from modules.probe import FactModel, Probe, quantity

KERNEL = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
KERNEL_GAIN = 6.0  # root of the sum of squares of the kernel
BLOCK_PX = 16
LOW_QUANTILE = 0.15  # smoothest blocks; texture fills the others
LOW_BIAS = 0.93  # mean of |Laplacian| in the smoothest 15 % of pure-noise blocks relative to all


class Noise(FactModel):
    """Standard deviation of the noise, from the smoothest blocks."""

    template: ClassVar[str] = "noise"

    left_sigma_dn: float = quantity("Noise of the left image", unit="dn", ge=0, resolution=0.01)
    right_sigma_dn: float = quantity("Noise of the right image", unit="dn", ge=0, resolution=0.01)
    difference_dn: float = quantity("Right minus left noise", unit="dn", resolution=0.01)


def estimate_noise_dn(plane: NDArray[np.uint8]) -> float:
    """Estimate the noise of one plane from the Laplacian of its smoothest blocks, dn.

    Parameters
    ----------
    plane : uint8 (H, W)
        Clipped and black blocks carry no noise and are left out.

    References
    ----------
    J. Immerkaer, Fast noise variance estimation, CVIU 64(2), 1996.
    """
    if min(plane.shape) < 3 * BLOCK_PX:
        return 0.0
    response = np.abs(cv2.filter2D(plane, cv2.CV_16S, KERNEL))
    size = (plane.shape[1] // BLOCK_PX, plane.shape[0] // BLOCK_PX)
    crop = (slice(0, size[1] * BLOCK_PX), slice(0, size[0] * BLOCK_PX))
    strength = cv2.resize(response[crop].astype(np.float32), size, interpolation=cv2.INTER_AREA)
    level = cv2.resize(plane[crop], size, interpolation=cv2.INTER_AREA)
    usable = strength[(level > 4) & (level < 250)]
    if usable.size < 10:
        return 0.0
    smoothest = float(np.quantile(usable, LOW_QUANTILE))
    return float(np.sqrt(np.pi / 2) * smoothest / KERNEL_GAIN / LOW_BIAS)


def measure_noise(sample: Sample) -> list[Noise]:
    """Return the one `noise` fact of the pair; the green channel of colour images, half of the rows."""
    sigmas = []
    for image, gray in zip((sample.views.left, sample.views.right), sample.gray8, strict=True):
        plane = gray
        if image.ndim == 3:
            plane = to_8_bit(np.ascontiguousarray(image[..., 1]))
        sigmas.append(estimate_noise_dn(plane))
    return [Noise(left_sigma_dn=sigmas[0], right_sigma_dn=sigmas[1], difference_dn=sigmas[1] - sigmas[0])]


PROBE = Probe(
    "measurement.noise", (Noise,), measure_noise, "cheap", "pair", "Estimates the noise from the smoothest blocks."
)
