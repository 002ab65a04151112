"""How much better two images match than chance would have it: the same search on a pair that cannot match."""

from __future__ import annotations

import cv2
import numpy as np

from modules.primitives.coarse import SMALLEST_PX, Gray, coarse_factor, match_normalised, normalise, sixteens
from modules.primitives.photometry import shrink
from modules.types import FloatImage

WIDTH_PX = 96  # of the thumbnails: enough windows for a mean, and searched in half a millisecond
WINDOW_PX = 7  # in which matched thumbnails are correlated
NOISE_VARIANCE = 16.0  # of the normalised thumbnails, DN^2


def agreement_over_chance(left: Gray, right: Gray, first_px: float, last_px: float) -> float | None:
    """Return how much of what chance leaves open the matched images agree: 0 for unrelated images, 1 at most.

    Thumbnails are matched and correlated window by window, once with the right image as it is and once upside down.
    Search, smoothness and texture are the same in both, so what two unrelated images reach is the second figure.

    Parameters
    ----------
    left, right : uint8 (H, W)
        Luminance.
    first_px, last_px : float
        Disparities to search, px of the images.

    Returns
    -------
    float or None
        (agreement - chance) / (1 - chance), at least -1; None for images of less than 24 px.

    Notes
    -----
    Images that are symmetric from top to bottom, such as an even pattern, agree no better than chance.
    """
    factor = coarse_factor((left.shape[0], left.shape[1]), WIDTH_PX)
    size = (round(left.shape[1] * factor), max(1, round(left.shape[0] * factor)))
    if min(size) < SMALLEST_PX:
        return None
    one, other = (normalise(shrink(image, *size) if factor < 1 else image) for image in (left, right))
    first = int(np.floor(first_px * factor))
    last = last_px * factor
    own, chance = (_agreement(one, image, first, last) for image in (other, np.ascontiguousarray(other[::-1])))
    return max((own - chance) / (1.0 - chance), -1.0)


def _agreement(left: Gray, right: Gray, first: int, last: float) -> float:
    """Return the mean correlation of the windows that match, those that match nothing or badly counted as 0.

    Both thumbnails are locally normalised.
    """
    disparity = match_normalised(left, right, first, sixteens(last - first))
    with np.errstate(invalid="ignore"):
        valid = disparity <= last  # more than asked for is searched, up to a multiple of 16
    rows, columns = disparity.shape
    column = np.where(valid, np.arange(columns, dtype=np.float32) - disparity, np.float32(0.0)).astype(np.float32)
    row = np.repeat(np.arange(rows, dtype=np.float32)[:, None], columns, axis=1)
    one, there = left.astype(np.float32), right.astype(np.float32)
    other = np.asarray(cv2.remap(there, column, row, cv2.INTER_LINEAR), np.float32)
    mean_one, mean_other = _mean(one), _mean(other)
    spread_one = _mean(one * one) - mean_one * mean_one + np.float32(NOISE_VARIANCE)
    spread_other = _mean(other * other) - mean_other * mean_other + np.float32(NOISE_VARIANCE)
    correlation = (_mean(one * other) - mean_one * mean_other) / np.sqrt(spread_one * spread_other)
    return min(float(np.maximum(correlation[valid], 0.0).sum()) / disparity.size, 0.999)


def _mean(image: FloatImage) -> FloatImage:
    return np.asarray(cv2.blur(image, (WINDOW_PX, WINDOW_PX)), np.float32)
