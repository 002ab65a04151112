"""Refine disparities by the intensities around each pixel."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

from modules.matching.common import Bytes
from modules.types import FloatImage

DERIVATIVE = np.array([[1.0, -8.0, 0.0, 8.0, -1.0]], np.float32) / np.float32(12.0)  # per px, exact for cubics


def refine_by_intensity(
    left: Bytes,
    right: Bytes,
    disparity: FloatImage,
    pool: ThreadPoolExecutor | None,
    radius: int = 2,
    passes: int = 1,
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
    pool : ThreadPoolExecutor or None
        Does two parts at once; the result does not depend on that.
    radius : int
        Half side of the window, px.
    passes : int
        Steps.

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
    halves = (0, rows // 2), (rows // 2, rows)
    wanted, target = left.astype(np.float32), right.astype(np.float32)
    slope = cv2.filter2D(target, cv2.CV_32F, DERIVATIVE, borderType=cv2.BORDER_REPLICATE)
    smooth, warped, warped_slope, refined = (np.empty((rows, columns), np.float32) for _ in range(4))
    across = np.arange(columns, dtype=np.float32)

    def work(start: int, stop: int) -> None:
        part = slice(start, stop)
        refinement.smooth_rows(current, radius, start, stop, smooth)
        down = np.repeat(np.arange(start, stop, dtype=np.float32)[:, None], columns, axis=1)
        at = across - smooth[part]
        warped[part] = cv2.remap(target, at, down, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        warped_slope[part] = cv2.remap(slope, at, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def fit(start: int, stop: int) -> None:
        refinement.fit_rows(wanted, warped, warped_slope, smooth, radius, start, stop, refined)

    current = disparity
    for _ in range(passes):
        for step in (work, fit):
            if pool is None:
                step(0, rows)
                continue
            for half in [pool.submit(step, *bounds) for bounds in halves]:
                half.result()
        current = refined
    return refined
