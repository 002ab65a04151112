"""What the semi-global matcher compares: bits and a value for every pixel of both images.

Every cost is the number of bits that differ plus the difference of the values, up to a limit; see `kernels.cost`.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.matching.common import Bytes, do_all

CostName = Literal["hybrid", "census", "ternary_census", "sobel", "absolute_difference"]
CensusName = Literal["3x3", "5x5", "7x7", "9x7", "9x9_sparse"]
Offsets = NDArray[np.int64]

FINENESS = 16  # levels per DN of the smoothed image, so that smoothing tells apart what rounding made equal
CENTRE = 128  # value that stands for no horizontal derivative
KNEE = 32.0  # derivatives beyond this count by their logarithm, so that contrast edges compare too; Sobel units
BRIGHT_DN, DARK_DN = 100.0, 10.0  # derivatives are those of a scene of this mean brightness; darkness counts as this
BRIGHTNESS_PX = 9  # side of the window of the mean brightness, px
STEEPEST = 1023  # derivatives are cut off here, where their byte is full; Sobel units
VECTOR = 32  # disparities that the kernels count at once


@dataclass(frozen=True)
class Features:
    """Bits and values of both images, as `kernels.cost.cost_rows` reads them, and how they add up.

    Attributes
    ----------
    left : uint8 (H, W, K + 1)
        K bytes of bits and a value.
    right : uint8 (K + 1, H, L)
        The same, from right to left and continued beyond the border.
    before : int
        Where in a row of `right` the first left pixel meets the first disparity.
    bit_shift, value_limit : int
        A pixel costs `bits << bit_shift` plus the difference of the values, at most the limit.
    unit : float
        Cost that counts as one bit of a census of 24 comparisons, the unit of the penalties.
    """

    left: Bytes
    right: Bytes
    before: int
    bit_shift: int
    value_limit: int
    unit: float


def census_offsets(name: CensusName) -> Offsets:
    """Return the rows and columns (N, 2), from the centre, that a census compares."""
    if name == "9x9_sparse":
        places = [*_grid(9, 9, 2), *_grid(3, 3, 1)]
    else:
        columns, rows = (int(side) for side in name.split("x"))
        places = _grid(columns, rows, 1)
    return np.array([place for place in places if place != (0, 0)], np.int64)


def _grid(columns: int, rows: int, step: int) -> list[tuple[int, int]]:
    """Return the rows and columns of every `step`-th pixel of a window, from its centre."""
    across, down = columns // 2, rows // 2
    return [(dy, dx) for dy in range(-down, down + 1, step) for dx in range(-across, across + 1, step)]


def smooth_levels(image: Bytes, sigma_px: float) -> NDArray[np.int16]:
    """Return the image in levels of 1/16 DN, smoothed."""
    fine = image.astype(np.int16) * np.int16(FINENESS)
    if sigma_px > 0:
        fine = np.asarray(cv2.GaussianBlur(fine, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), np.int16)
    return fine


def in_vectors(count: int) -> int:
    """Return so many disparities or a few more, as many as whole vectors hold."""
    return -(-count // VECTOR) * VECTOR


def window_of(cost: CostName, census: CensusName) -> int:
    """Return the side of the window that a pixel's features depend on, px."""
    return 3 if cost in ("sobel", "absolute_difference") else int(census[0])


def census_bits(levels: NDArray[np.int16], offsets: Offsets, margin: int, ternary: bool) -> Bytes:
    """Return the comparisons of each pixel with its centre, as bits in bytes (K, H, W); borders are replicated."""
    from modules.matching.kernels.census import census

    radius = int(np.abs(offsets).max())
    wide = cv2.copyMakeBorder(levels, radius, radius, radius, radius, cv2.BORDER_REPLICATE)
    bits = len(offsets) * (2 if ternary else 1)
    out = np.zeros((-(-bits // 8), *levels.shape), np.uint8)
    census(np.asarray(wide, np.int16), offsets, margin, ternary, out)
    return out


def slope_values(levels: NDArray[np.int16]) -> Bytes:
    """Return the horizontal derivative (H, W) in proportion to the brightness around, as bytes.

    Linear where it is small and logarithmic where it is large, so that neither a darker image nor a contrast edge
    outweighs the rest.
    """
    slope = cv2.Sobel(levels, cv2.CV_32F, 1, 0, ksize=3, borderType=cv2.BORDER_REPLICATE)
    side = (BRIGHTNESS_PX, BRIGHTNESS_PX)
    brightness = cv2.boxFilter(levels, cv2.CV_32F, side, borderType=cv2.BORDER_REPLICATE)
    relative = cv2.divide(slope, brightness + np.float32(DARK_DN * FINENESS), scale=BRIGHT_DN)
    index = np.clip(np.rint(relative), -STEEPEST, STEEPEST).astype(np.int16) + np.int16(STEEPEST)
    table = CENTRE + KNEE * np.arcsinh(np.arange(-STEEPEST, STEEPEST + 1) / KNEE)
    return np.clip(np.rint(table), 0, 255).astype(np.uint8)[index]


def compute_features(
    left: Bytes,
    right: Bytes,
    low: int,
    count: int,
    cost: CostName,
    census: CensusName,
    smooth_px: float = 0.0,
    margin_dn: int = 0,
    pool: ThreadPoolExecutor | None = None,
) -> Features:
    """Return what is compared.

    Parameters
    ----------
    left, right : uint8 (H, W)
    low, count : int
        First disparity and their number, px.
    cost, census : str
    smooth_px : float
        Sigma of the smoothing before, px.
    margin_dn : int
        Of the ternary census: smaller differences count as none.
    pool : ThreadPoolExecutor or None
        Does both images at once.
    """
    before = left.shape[1] - 1
    length = before + in_vectors(count)

    def prepare(side: Literal["left", "right"]) -> Bytes:
        levels = smooth_levels(left if side == "left" else right, smooth_px)
        planes = _planes(levels, cost, census, margin_dn)
        if side == "left":
            return np.ascontiguousarray(np.moveaxis(planes, 0, -1))
        return _continued(planes[:, :, ::-1], -low, length)

    sides: tuple[Literal["left", "right"], ...] = ("left", "right")
    one, other = do_all(pool, prepare, sides)
    bits = len(census_offsets(census)) * (2 if cost == "ternary_census" else 1)
    if cost == "sobel":
        shift, limit, unit = 0, 63, 4.0
    elif cost == "absolute_difference":
        shift, limit, unit = 0, 63, 2.0
    elif cost == "hybrid":
        shift, limit, unit = 1, 31, 2.0 * bits / 24.0
    else:
        shift, limit, unit = 0, 0, bits / 24.0
    return Features(one, other, before, shift, limit, unit)


def _continued(planes: Bytes, first: int, length: int) -> Bytes:
    """Return planes (K, H, length) whose columns begin at `first`, with the border columns repeated around."""
    columns = planes.shape[2]
    out = np.empty((*planes.shape[:2], length), np.uint8)
    begin, end = min(max(first, 0), length), min(max(first + columns, 0), length)
    out[:, :, :begin] = planes[:, :, :1]
    out[:, :, begin:end] = planes[:, :, begin - first : end - first]
    out[:, :, end:] = planes[:, :, -1:]
    return out


def _planes(levels: NDArray[np.int16], cost: CostName, census: CensusName, margin_dn: int) -> Bytes:
    """Return the planes of bits and the one of values (K + 1, H, W) of an image."""
    if cost == "absolute_difference":
        return np.asarray((levels + FINENESS // 2) // FINENESS, np.uint8)[None]
    if cost == "sobel":
        return slope_values(levels)[None]
    ternary = cost == "ternary_census"
    bits = census_bits(levels, census_offsets(census), margin_dn * FINENESS if ternary else 0, ternary)
    if cost != "hybrid":
        return np.concatenate([bits, np.zeros((1, *levels.shape), np.uint8)])
    return np.concatenate([bits, slope_values(levels)[None]])
