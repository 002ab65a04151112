"""Subpixel warps of images with a mask of where the result is defined."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.rows import RowModel, centre
from modules.types import Image, Mask


def row_alignment_map(model: RowModel, shape: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the column and row of the right image to read for each pixel of the aligned right image.

    The roll is undone as a whole rotation about the image centre; offset and row scale move rows only.

    Returns
    -------
    float32 (H, W), float32 (H, W)
    """
    height, width = shape
    cx, cy = centre(shape)
    v, u = np.mgrid[0:height, 0:width].astype(np.float64)
    cosine, sine = np.cos(model.roll_rad), np.sin(model.roll_rad)
    x = cosine * (u - cx) - sine * (v - cy)
    y = ((v - cy) + model.offset_px + np.tan(model.roll_rad) * x) / (1 - model.scale)
    return (x + cx).astype(np.float32), (y + cy).astype(np.float32)


def warp(image: Image, x_px: NDArray[np.float32], y_px: NDArray[np.float32]) -> tuple[Image, Mask]:
    """Resample an image by bicubic interpolation.

    Returns
    -------
    image : (H, W) or (H, W, 3), same dtype
        Border pixels repeat beyond the image.
    inside : bool (H, W)
        True where the position read lies inside the image.
    """
    warped: Any = cv2.remap(image, x_px, y_px, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    height, width = image.shape[:2]
    slack = 1e-3  # float32 coordinates of the border itself
    inside = (x_px >= -slack) & (x_px <= width - 1 + slack) & (y_px >= -slack) & (y_px <= height - 1 + slack)
    return warped, inside
