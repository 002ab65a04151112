"""Small synthetic pairs with known disparity."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from expert import StereoPair

SHIFT_PX = 8


def texture(seed: int, width: int = 160, height: int = 120, sigma_px: float = 1.2) -> NDArray[np.uint8]:
    """Return blurred noise of mean 128 and standard deviation 40."""
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (height, width))
    noise = cv2.GaussianBlur(noise, (0, 0), sigma_px)
    return np.clip(128.0 + 40.0 * noise / noise.std(), 0, 255).astype(np.uint8)


def shifted(seed: int = 1, width: int = 160, height: int = 120) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return left and right image of a plane at a disparity of `SHIFT_PX`."""
    scene = texture(seed, width + SHIFT_PX, height)
    return scene[:, :width].copy(), scene[:, SHIFT_PX:].copy()


def shifted_pair(seed: int = 1, **known: Any) -> StereoPair:
    """Return the same as a `StereoPair`."""
    left, right = shifted(seed)
    return StereoPair(left, right, **known)
