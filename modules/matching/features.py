"""What the semi-global matcher compares: bits and a value for every pixel of both images.

Every cost is the number of bits that differ plus the difference of the values, up to a limit; see `kernels.cost`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.matching.common import Bytes

CostName = Literal["hybrid", "census", "ternary_census", "sobel", "absolute_difference"]
CensusName = Literal["3x3", "5x5", "7x7", "9x7", "9x9_sparse"]
Offsets = NDArray[np.int64]

CENTRE = 128  # value that stands for no horizontal derivative
KNEE = 32.0  # derivatives beyond this count by their logarithm, so that contrast edges compare too; Sobel units
VECTOR = 32  # the kernels read whole vectors


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
        grid = [(dy, dx) for dy in range(-4, 5, 2) for dx in range(-4, 5, 2)]
    else:
        columns, rows = (int(side) for side in name.split("x"))
        grid = [
            (dy, dx) for dy in range(-(rows // 2), rows // 2 + 1) for dx in range(-(columns // 2), columns // 2 + 1)
        ]
    return np.array([place for place in grid if place != (0, 0)], np.int64)


def window_of(cost: CostName, census: CensusName) -> int:
    """Return the side of the window that a pixel's features depend on, px."""
    return 3 if cost in ("sobel", "absolute_difference") else int(census[0])


def census_bits(image: Bytes, offsets: Offsets, margin: int, ternary: bool) -> Bytes:
    """Return the comparisons of each pixel with its centre, as bits in bytes (K, H, W); borders are replicated."""
    from modules.matching.kernels.census import census

    radius = int(np.abs(offsets).max())
    wide = cv2.copyMakeBorder(image, radius, radius, radius, radius, cv2.BORDER_REPLICATE)
    bits = len(offsets) * (2 if ternary else 1)
    out = np.zeros((-(-bits // 8), *image.shape), np.uint8)
    census(wide.astype(np.int16), offsets, margin, ternary, out)
    return out


def slope_values(image: Bytes) -> Bytes:
    """Return the horizontal derivative (H, W) as bytes, linear where it is small and logarithmic where it is large."""
    slope = cv2.Sobel(image, cv2.CV_16S, 1, 0, ksize=3, borderType=cv2.BORDER_REPLICATE)
    table = CENTRE + KNEE * np.arcsinh(np.arange(-1020, 1021) / KNEE)
    return np.clip(np.rint(table), 0, 255).astype(np.uint8)[slope.astype(np.intp) + 1020]


def compute_features(
    left: Bytes, right: Bytes, low: int, count: int, cost: CostName, census: CensusName, margin_dn: int
) -> Features:
    """Return what is compared.

    Parameters
    ----------
    left, right : uint8 (H, W)
    low, count : int
        First disparity and their number, px.
    cost, census : str
    margin_dn : int
        Of the ternary census: smaller differences count as none.
    """
    planes = [_planes(image, cost, census, margin_dn) for image in (left, right)]
    bits = len(census_offsets(census)) * (2 if cost == "ternary_census" else 1)
    if cost == "sobel":
        shift, limit, unit = 0, 63, 4.0
    elif cost == "absolute_difference":
        shift, limit, unit = 0, 63, 2.0
    elif cost == "hybrid":
        shift, limit, unit = 1, 31, 2.0 * bits / 24.0
    else:
        shift, limit, unit = 0, 0, bits / 24.0
    columns = left.shape[1]
    before = columns - 1
    length = before + -(-count // VECTOR) * VECTOR
    across = np.clip(before - low - np.arange(length), 0, columns - 1)
    return Features(
        np.ascontiguousarray(np.moveaxis(planes[0], 0, -1)),
        np.ascontiguousarray(planes[1][:, :, across]),
        before,
        shift,
        limit,
        unit,
    )


def _planes(image: Bytes, cost: CostName, census: CensusName, margin_dn: int) -> Bytes:
    """Return the planes of bits and the one of values (K + 1, H, W) of an image."""
    if cost == "absolute_difference":
        return image[None]
    if cost == "sobel":
        return slope_values(image)[None]
    ternary = cost == "ternary_census"
    bits = census_bits(image, census_offsets(census), margin_dn if ternary else 0, ternary)
    value = slope_values(image) if cost == "hybrid" else np.zeros_like(image)
    return np.concatenate([bits, value[None]])
