"""A coarse dense match of locally normalised thumbnails, for probes that need correspondences everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.photometry import normalise_contrast
from modules.primitives.rows import RowFit, RowModel
from modules.primitives.warp import row_alignment_map, warp
from modules.types import Correspondences, DisparityRange

WIDTH_PX = 360  # width of the thumbnails
LEAST_VALID = 0.05  # fraction of pixels that must match


@dataclass(frozen=True)
class CoarseMatch:
    """Result of the coarse match.

    Attributes
    ----------
    left, right : uint8 (h, w)
        Thumbnails, rows aligned, not normalised.
    disparity_px : float32 (h, w)
        In px of the thumbnail; NaN where nothing matched.
    low_px, high_px : float
        0.5th and 99.5th percentile of the disparity in px of the full image.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    disparity_px: NDArray[np.float32]
    low_px: float
    high_px: float


def coarse_match(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    given_range: DisparityRange | None,
    agreeing: Correspondences | None,
    fit: RowFit | None,
) -> CoarseMatch | None:
    """Match the pair at a width of 360 px, over the range of its sparse matches widened by 60 % at both ends.

    Returns None without enough sparse matches (or a given range), or where less than 5 % of the pixels match.
    """
    model = RowModel()
    shape = left.shape[0], left.shape[1]
    if given_range is not None:
        low, high = float(given_range.min_px), float(given_range.max_px)
    else:
        if fit is None or agreeing is None or len(agreeing) < 8:
            return None
        model = fit.model
        low, high = np.percentile((agreeing.left_xy - agreeing.right_xy)[:, 0], (1, 99))
        widen = max(6.0, 0.6 * (high - low))
        low, high = low - widen, high + widen
    if model.max_abs_px(shape) > 0.3:
        right = warp(right, *row_alignment_map(model, shape))[0].astype(np.uint8, copy=False)
    factor = min(1.0, WIDTH_PX / shape[1])
    if factor < 1:
        left, right = (
            np.asarray(cv2.resize(x, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), np.uint8)
            for x in (left, right)
        )
    first = int(np.floor(low * factor))
    count = max(16, int(np.ceil((high * factor - first) / 16)) * 16)
    disparity = _semi_global(left, right, first, count)
    valid = disparity[np.isfinite(disparity)]
    if valid.size < LEAST_VALID * disparity.size:
        return None
    low_px, high_px = np.percentile(valid, (0.5, 99.5)) / factor
    return CoarseMatch(left, right, disparity, float(low_px), float(high_px))


def _semi_global(left: NDArray[np.uint8], right: NDArray[np.uint8], first: int, count: int) -> NDArray[np.float32]:
    normalised = [np.clip(128 + 40 * normalise_contrast(x, 6.0, 3.0), 0, 255).astype(np.uint8) for x in (left, right)]
    # Pad so that the columns whose match lies outside of the image do not lose the border of the range.
    pad_left, pad_right = max(0, first + count), max(0, -first)
    padded = [cv2.copyMakeBorder(x, 0, 0, pad_left, pad_right, cv2.BORDER_REPLICATE) for x in normalised]
    matcher = cv2.StereoSGBM.create(
        minDisparity=first, numDisparities=count, blockSize=5, P1=8 * 25, P2=48 * 25, disp12MaxDiff=1,
        preFilterCap=63, uniquenessRatio=12, speckleWindowSize=60, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM,
    )  # fmt: skip
    raw = matcher.compute(*padded)[:, pad_left : pad_left + left.shape[1]]
    disparity: NDArray[np.float32] = raw.astype(np.float32) / np.float32(16)
    columns = np.arange(left.shape[1], dtype=np.float32)[None, :]
    outside = (columns - disparity < 0) | (columns - disparity > left.shape[1] - 1)
    disparity[(raw < first * 16) | outside] = np.nan
    return disparity
