"""Noise of one image plane."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

KERNEL = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
KERNEL_GAIN = 6.0  # root of the sum of squares of the kernel
BLOCK_PX = 16
LOW_QUANTILE = 0.15  # smoothest blocks; texture fills the others
STRIP_PX = 64  # rows that are filtered at once; of large images only every second or third strip is
ENOUGH_PX = 300_000  # pixels that suffice
LOW_BIAS = 0.93  # mean of |Laplacian| in the smoothest 15 % of pure-noise blocks relative to all


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
    step = STRIP_PX * max(1, plane.size // ENOUGH_PX)
    strips = [plane[row : row + STRIP_PX] for row in range(0, plane.shape[0] - BLOCK_PX + 1, step)]
    strength, level = (np.concatenate(parts) for parts in zip(*map(_blocks, strips), strict=True))
    usable = strength[(level > 4) & (level < 250)]
    if usable.size < 10:
        return 0.0
    smoothest = float(np.quantile(usable, LOW_QUANTILE))
    return float(np.sqrt(np.pi / 2) * smoothest / KERNEL_GAIN / LOW_BIAS)


def _blocks(strip: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return the mean of |Laplacian| and the mean level of each block, flat."""
    response = np.abs(cv2.filter2D(strip, cv2.CV_16S, KERNEL))
    size = (strip.shape[1] // BLOCK_PX, strip.shape[0] // BLOCK_PX)
    crop = (slice(0, size[1] * BLOCK_PX), slice(0, size[0] * BLOCK_PX))
    strength = cv2.resize(response[crop].astype(np.float32), size, interpolation=cv2.INTER_AREA)
    level = cv2.resize(strip[crop], size, interpolation=cv2.INTER_AREA)
    return np.asarray(strength, np.float32).ravel(), np.asarray(level, np.uint8).ravel()
