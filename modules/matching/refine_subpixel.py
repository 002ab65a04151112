"""Refine disparities by the intensities around each pixel."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np

from modules.matching.common import Bytes, do_all, halves
from modules.types import DisparityRange, FloatImage

DERIVATIVE = np.array([[1.0, -8.0, 0.0, 8.0, -1.0]], np.float32) / np.float32(12.0)  # per px, exact for cubics


@dataclass(frozen=True)
class Window:
    """How intensities are compared.

    Attributes
    ----------
    columns, rows : int
        Half width and half height of the window, px.
    passes : int
        Steps.
    misfit_weight : float
        Counts the misfit that remains as noise: 1 where it is independent from pixel to pixel, as sensor noise is, more
        where neighbours err alike.
    """

    columns: int = 2
    rows: int = 2
    passes: int = 1
    misfit_weight: float = 5.0


def refine_by_intensity(
    left: Bytes,
    right: Bytes,
    disparity: FloatImage,
    search: DisparityRange,
    pool: ThreadPoolExecutor | None,
    window: Window = Window(),
) -> FloatImage:
    """Return disparities moved to where the intensities of the right image fit those of the left one best.

    Gauss-Newton steps in a small window, with a gain and an offset of its own and only the neighbours of similar
    disparity. A step is damped by the misfit that remains, so that a flat or a disturbed window keeps its disparity;
    noise asks for more steps.

    Parameters
    ----------
    left, right : uint8 (H, W)
    disparity : float32 (H, W)
        Finite; wrong by a fraction of a pixel, px.
    search : DisparityRange
        What was searched; disparities at either end of it stay there.
    pool : ThreadPoolExecutor or None
        Does two parts at once; the result does not depend on that.
    window : Window

    Returns
    -------
    float32 (H, W)

    References
    ----------
    A. W. Gruen, Adaptive Least Squares Correlation, South African Journal of Photogrammetry 14(3), 1985.
    M. Shimizu and M. Okutomi, Sub-pixel Estimation Error Cancellation on Area-Based Matching, IJCV 63(3), 2005.
    """
    from modules.matching.kernels import refinement

    rows, columns = disparity.shape
    radius, tall = window.columns, window.rows
    wanted, warped, warped_slope, current, smooth, inside, refined = (
        room_with_margins(disparity.shape, radius) for _ in range(7)
    )
    image = slice(radius, radius + columns)
    target, slope = (np.empty((rows, columns), np.float32) for _ in range(2))
    across = np.arange(columns, dtype=np.float32)

    def prepare(part: slice) -> None:
        wanted[part, image], target[part], current[part, image] = left[part], right[part], disparity[part]
        slope[part] = cv2.filter2D(target[part], cv2.CV_32F, DERIVATIVE, borderType=cv2.BORDER_REPLICATE)

    def warp(part: slice) -> None:
        refinement.smooth_rows(before, columns, radius, tall, part.start, part.stop, smooth)
        down = np.repeat(np.arange(part.start, part.stop, dtype=np.float32)[:, None], columns, axis=1)
        found = smooth[part, image]
        at = across - found
        inside[part, image] = np.where((at >= -0.5) & (at <= columns - 0.5), found, np.float32(np.inf))
        warped[part, image] = cv2.remap(target, at, down, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        warped_slope[part, image] = cv2.remap(slope, at, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def fit(part: slice) -> None:
        moved = (warped, warped_slope, smooth, inside)
        size = (columns, radius, tall, window.misfit_weight)
        refinement.fit_rows(wanted, *moved, *size, part.start, part.stop, refined)

    def hold(part: slice) -> None:
        refined[part, image] = _held_at_ends(refined[part, image], disparity[part], search)

    do_all(pool, prepare, halves(rows))
    before = current
    for _ in range(window.passes):
        for step in (warp, fit):
            do_all(pool, step, halves(rows))
        before = refined
    do_all(pool, hold, halves(rows))
    return np.ascontiguousarray(refined[:, image])


def room_with_margins(shape: tuple[int, ...], radius: int) -> FloatImage:
    """Return room for an image (H, W) with margins on both sides that count as another surface to the kernels.

    The image begins at column `radius`. Windows and vectors that begin in the image may end in a margin.
    """
    from modules.matching.kernels.vectors import FLOAT_LANES

    rows, columns = shape
    out = np.empty((rows, columns + 2 * radius + FLOAT_LANES), np.float32)
    out[:, :radius] = out[:, radius + columns :] = np.inf
    return out


def _held_at_ends(refined: FloatImage, disparity: FloatImage, search: DisparityRange) -> FloatImage:
    """Keep disparities at an end of the range within half a pixel: they say that the true one may lie beyond."""
    low, high = np.float32(search.min_px), np.float32(search.max_px - 1)
    half = np.float32(0.499)
    floor = np.where(disparity == high, high - half, np.where(disparity == low, low, low + 1 - half))
    ceiling = np.where(disparity == low, low + half, np.where(disparity == high, high, high - 1 + half))
    return np.clip(refined, floor, ceiling).astype(np.float32)
