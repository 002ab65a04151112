"""A dense match of thumbnails: corresponding pixels nearly everywhere, for little time."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.photometry import shrink, standardise_to_bytes
from modules.primitives.statistics import percentiles
from modules.types import FloatImage

Gray = NDArray[np.uint8]

WIDTH_PX = 200  # of the thumbnails: noise and small row errors vanish, and half the width is searched in 10 ms
WINDOW_PX = 9  # of the local normalisation
DAMPING_DN = 3.0  # added to the local deviation; noise where there is no texture stays small
SMALLEST_PX = 24  # shorter sides give no match
LEAST_VALID = 0.05  # of the thumbnail's pixels
WORTH_NARROWING_PX = 48  # disparities; fewer are searched as they are
NARROWING_SHARE = 0.3  # of the pixels of the smaller thumbnails must match, or their range is not believed
NARROWING_PERCENT = (1.0, 99.0)
NARROWING_MARGIN = 0.25  # of the range found
NARROWING_MARGIN_PX = 4.0


@dataclass(frozen=True)
class CoarseMatch:
    """Thumbnails of a pair and the disparity between them.

    Attributes
    ----------
    left, right : uint8 (h, w)
        Luminance, not normalised.
    disparity_px : float32 (h, w)
        In px of the thumbnail, indexed by the left one; NaN where nothing matched.
    factor : float
        Columns of the thumbnail per column of the image.
    """

    left: Gray
    right: Gray
    disparity_px: FloatImage
    factor: float

    @property
    def valid_fraction(self) -> float:
        """Share of the thumbnail's pixels that matched."""
        return float(np.isfinite(self.disparity_px).mean())

    def disparity_at(self, xy: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the disparity in px of the image at points (N, 2) of the left image; NaN where nothing matched."""
        height, width = self.disparity_px.shape
        column = np.clip((xy[:, 0] * self.factor).astype(int), 0, width - 1)
        row = np.clip((xy[:, 1] * self.factor).astype(int), 0, height - 1)
        return np.asarray(self.disparity_px[row, column] / np.float32(self.factor))

    def visible(self) -> FloatImage:
        """Return the disparity without the columns at the sides whose match lies outside the other image.

        What is matched there is matched wrongly, mostly with too small a disparity.
        """
        shown = self.disparity_px.copy()
        known = shown[np.isfinite(shown)]
        if known.size == 0:
            return shown
        width = shown.shape[1]
        small, large = percentiles(known, (5, 95))
        shown[:, : int(np.clip(large, 0, 0.6 * width))] = np.nan
        shown[:, width - int(np.clip(-small, 0, 0.6 * width)) :] = np.nan
        return shown


def coarse_factor(shape: tuple[int, int], width: int = WIDTH_PX) -> float:
    """Return the columns of the thumbnail per column of an image of `shape`."""
    return min(1.0, width / shape[1])


def coarse_match(left: Gray, right: Gray, first_px: float, last_px: float, width: int = WIDTH_PX) -> CoarseMatch | None:
    """Match locally normalised thumbnails densely.

    Parameters
    ----------
    left, right : uint8 (H, W)
        Luminance. Rows may be off by about 2 px of the thumbnail.
    first_px, last_px : float
        Disparities to search, px of the images.
    width : int
        Width of the thumbnails, px; smaller images are taken as they are.

    Returns
    -------
    CoarseMatch or None
        None for images of less than 24 px, or where less than 5 % of the pixels match.
    """
    factor = coarse_factor((left.shape[0], left.shape[1]), width)
    size = (round(left.shape[1] * factor), max(1, round(left.shape[0] * factor)))
    if min(size) < SMALLEST_PX:
        return None
    if factor < 1:
        left, right = shrink(left, *size), shrink(right, *size)
    first, last = _narrowed([left, right], int(np.floor(first_px * factor)), int(np.ceil(last_px * factor)))
    match = CoarseMatch(left, right, match_thumbnails(left, right, first, sixteens(last - first)), factor)
    return match if match.valid_fraction >= LEAST_VALID else None


def _narrowed(planes: list[Gray], first: int, last: int) -> tuple[int, int]:
    """Return the part of a range that thumbnails of half the size match in, with a margin; all of it if they hardly do.

    An eighth of the work, and it saves two thirds of the rest where the range is wide.
    """
    height, width = planes[0].shape
    if last - first < WORTH_NARROWING_PX or min(height, width) < 2 * SMALLEST_PX:
        return first, last
    left, right = (shrink(x, width // 2, height // 2) for x in planes)
    low = int(np.floor(first / 2))
    disparity = match_thumbnails(left, right, low, sixteens(last / 2 - low))
    shown = CoarseMatch(left, right, disparity, 0.5).visible()
    known = shown[np.isfinite(shown)]
    if known.size < NARROWING_SHARE * disparity.size:
        return first, last
    least, most = 2 * percentiles(known, NARROWING_PERCENT)
    margin = NARROWING_MARGIN_PX + NARROWING_MARGIN * (most - least)
    return max(first, int(np.floor(least - margin))), min(last, int(np.ceil(most + margin)))


def sixteens(span: float) -> int:
    """Return the next multiple of 16, at least 16."""
    return max(16, 16 * int(np.ceil(span / 16)))


def match_thumbnails(left: Gray, right: Gray, first: int, count: int) -> FloatImage:
    """Return the disparity of thumbnails (H, W) among `count`, a multiple of 16, from `first` on; NaN where none."""
    return match_normalised(normalise(left), normalise(right), first, count)


def normalise(thumbnail: Gray) -> Gray:
    """Return a thumbnail locally normalised, as it is matched."""
    return standardise_to_bytes(thumbnail, WINDOW_PX, DAMPING_DN)


def match_normalised(left: Gray, right: Gray, first: int, count: int) -> FloatImage:
    """Return the disparity of normalised thumbnails (H, W), uint8, as `match_thumbnails` does of thumbnails."""
    # Pad so that the columns whose match lies outside of the image do not lose the border of the range.
    before, after = max(0, first + count), max(0, -first)
    padded = [cv2.copyMakeBorder(x, 0, 0, before, after, cv2.BORDER_REPLICATE) for x in (left, right)]
    matcher = cv2.StereoSGBM.create(
        minDisparity=first, numDisparities=count, blockSize=5, P1=8 * 25, P2=48 * 25, disp12MaxDiff=1,
        preFilterCap=63, uniquenessRatio=12, speckleWindowSize=40, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    raw = matcher.compute(*padded)[:, before : before + left.shape[1]]
    disparity: FloatImage = raw.astype(np.float32) / np.float32(16)
    columns = np.arange(left.shape[1], dtype=np.float32)[None, :] - disparity
    disparity[(raw < first * 16) | (columns < 0) | (columns > left.shape[1] - 1)] = np.nan
    return disparity
