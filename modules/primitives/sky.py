"""Find the sky in a gray image."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.types import Mask

VIGNETTE_DN = 60.0  # how much darker the corners of the sky may be than its mean has to be
SMOOTHER = 0.35  # local deviation of a dim sky over that of the lower half of the image


def find_sky(
    gray: NDArray[np.uint8], texture_dn: float = 4.0, brighter_dn: float = 10.0, max_edge_dn: float = 10.0
) -> Mask:
    """Return the smooth bright region that is connected with the top border.

    Works on a copy about 320 px wide: smooth pixels, brighter or far smoother than the lower half,
    connected with the top rows without crossing an edge, and covering at least a fifth of the top row.

    Parameters
    ----------
    gray : uint8 (H, W)
    texture_dn : float
        Largest local standard deviation (7x7 of the copy) of sky, dn.
    brighter_dn : float
        Least excess over the median of the lower half of the image, dn.
    max_edge_dn : float
        Smallest gradient magnitude that counts as an edge, dn/px of the copy.

    Returns
    -------
    bool (H, W)
        True on the sky; all False if there is none.
    """
    height, width = gray.shape
    factor = min(1.0, 320 / width)
    small = cv2.resize(gray, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA) if factor < 1 else gray
    values = small.astype(np.float32)
    if min(values.shape) < 16:
        return np.zeros(gray.shape, bool)
    mean = cv2.blur(values, (7, 7))
    spread = np.sqrt(np.maximum(cv2.blur(values * values, (7, 7)) - mean * mean, 0))
    edge = cv2.magnitude(cv2.Sobel(values, -1, 1, 0, scale=1 / 8), cv2.Sobel(values, -1, 0, 1, scale=1 / 8))
    ground = float(np.median(values[values.shape[0] // 2 :]))
    smooth = (spread < texture_dn) & (edge < max_edge_dn) & (mean > ground + brighter_dn - VIGNETTE_DN)
    _, labels = cv2.connectedComponents(smooth.astype(np.uint8), connectivity=4)
    # A black frame or a strip of padding may lie above the sky: the top 5 % of the rows count as the border.
    top = labels[: max(1, values.shape[0] // 20)].max(axis=0)
    ids, counts = np.unique(top[top > 0], return_counts=True)
    calm = SMOOTHER * float(np.median(spread[values.shape[0] // 2 :]))  # a dim sky is at least far smoother
    bright = np.array([_is_sky(values, spread, labels == i, ground + brighter_dn, calm) for i in ids], dtype=bool)
    main = np.isin(labels, ids[bright & (counts >= 0.2 * len(top))])
    region = main
    if main.any():  # the horizon may cut slivers of sky off
        likeness = np.array(
            [abs(float(values[labels == i].mean() - values[main].mean())) < 40 for i in ids], dtype=bool
        )
        region = main | np.isin(labels, ids[bright & likeness & (counts >= 0.02 * len(top))])
    if not region.any():
        return np.zeros(gray.shape, bool)
    # The windows stop short of the horizon by their half width: grow back over what is as bright, and close holes.
    grown = cv2.dilate(region.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    level = cv2.blur(np.where(region, values, 0), (31, 31)) / np.maximum(
        cv2.blur(region.astype(np.float32), (31, 31)), 1e-3
    )
    region |= grown & (np.abs(values - level) < 2.5 * texture_dn)
    filled = cv2.morphologyEx(region.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    return np.asarray(cv2.resize(filled, (width, height), interpolation=cv2.INTER_NEAREST) > 0)


def _is_sky(
    values: NDArray[np.float32], spread: NDArray[np.float32], region: Mask, bright_dn: float, calm_dn: float
) -> bool:
    level = float(values[region].mean())
    return level > bright_dn or (level > bright_dn - VIGNETTE_DN / 2 and float(np.median(spread[region])) < calm_dn)
