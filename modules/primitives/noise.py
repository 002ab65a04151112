"""Noise of one image plane."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

KERNEL = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
KERNEL_GAIN = 6.0  # root of the sum of squares of the kernel
BLOCK_PX = 16
LOW_QUANTILE = 0.15  # smoothest blocks; texture fills the others
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
