"""Matching cost of the semi-global matcher: census and horizontal derivatives, averaged over a window."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import intrinsic
from numpy.typing import NDArray

from modules.matching.kernels.compiler import kernel

CENSUS_RADIUS = 2  # 5x5 window, 24 comparisons
COST_UNITS = 6.25  # stored cost per bit of Hamming distance; the largest, 39.5, still fits uint8
COST_BLOCK = 64  # columns whose cost is averaged at a time, so that the sums stay in the cache
LANES = 16  # volumes hold a multiple of this many disparities, because a remainder would be worked off one by one
PADDING = 255  # cost of the disparities added for that; larger than any other, so that none is ever the best


def _count_bits(typing_context: Any, value: Any) -> Any:
    """Count the bits that are set; the compiler knows a vector instruction for it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return value(value), generate


_popcount: Any = intrinsic(_count_bits)


@kernel
def census(image: NDArray[np.int32]) -> NDArray[np.uint32]:
    """Return the 24 comparisons of each pixel's 5x5 window with its centre, as bits (H, W); borders are replicated."""
    rows, columns = image.shape
    out = np.zeros((rows, columns), np.uint32)
    for y in range(rows):
        for x in range(columns):
            centre = image[y, x]
            bits = np.uint32(0)
            for dy in range(-CENSUS_RADIUS, CENSUS_RADIUS + 1):
                yy = min(max(y + dy, 0), rows - 1)
                for dx in range(-CENSUS_RADIUS, CENSUS_RADIUS + 1):
                    if dy != 0 or dx != 0:
                        xx = min(max(x + dx, 0), columns - 1)
                        bits = np.uint32(np.uint32(bits << np.uint32(1)) | np.uint32(image[yy, xx] < centre))
            out[y, x] = bits
    return out


@kernel
def _mirror(
    bits: NDArray[np.uint32],
    slope: NDArray[np.int16],
    last: int,
    planes: NDArray[np.uint8],
    slopes: NDArray[np.int16],
) -> None:
    """Copy a row so that index j holds column `last - j`: rising disparity then walks forward through memory."""
    columns = bits.shape[0]
    for j in range(slopes.shape[0]):
        x = min(max(last - j, 0), columns - 1)
        planes[0, j] = np.uint8(bits[x])
        planes[1, j] = np.uint8(bits[x] >> np.uint32(8))
        planes[2, j] = np.uint8(bits[x] >> np.uint32(16))
        slopes[j] = slope[x]


@kernel
def _bit_difference(
    bits: np.uint32,
    low: NDArray[np.uint8],
    middle: NDArray[np.uint8],
    high: NDArray[np.uint8],
    out: NDArray[np.uint8],
) -> None:
    """Fill `out` (D,) with the Hamming distances of `bits` from 24 bits given in three planes."""
    a = np.uint8(bits)
    b = np.uint8(bits >> np.uint32(8))
    c = np.uint8(bits >> np.uint32(16))
    for d in range(out.shape[0]):
        one = _popcount(np.uint8(low[d] ^ a))
        two = _popcount(np.uint8(middle[d] ^ b))
        three = _popcount(np.uint8(high[d] ^ c))
        out[d] = np.uint8(np.uint8(one + two) + three)


@kernel
def _replace_cost(
    distance: NDArray[np.uint8],
    slope: np.int16,
    slopes: NDArray[np.int16],
    limit: np.int16,
    held: NDArray[np.uint8],
    column: NDArray[np.int16],
) -> None:
    """Put twice the cost of one pixel into `held` (D,) and its change into the sum `column` (D,)."""
    for d in range(held.shape[0]):
        difference = np.int16(slope - slopes[d])
        difference = min(max(difference, np.int16(-difference)), limit)
        value = np.int16(np.int16(np.int16(distance[d]) << np.int16(1)) + difference)
        column[d] = np.int16(np.int16(column[d] + value) - np.int16(held[d]))
        held[d] = np.uint8(value)


@kernel
def _slide(
    running: NDArray[np.int16],
    enter: NDArray[np.int16],
    leave: NDArray[np.int16],
    factor: np.uint16,
    out: NDArray[np.uint8],
) -> None:
    """Write the mean of the window in `running` (D,), then move it by one column."""
    for d in range(out.shape[0]):
        scaled = np.uint32(np.uint16(np.uint16(running[d]) << np.uint16(2)))
        out[d] = np.uint8(np.uint32(np.uint32(scaled * np.uint32(factor)) >> np.uint32(16)))
        running[d] = np.int16(np.int16(running[d] + enter[d]) - leave[d])


@kernel
def cost_rows(
    left_bits: NDArray[np.uint32],
    right_bits: NDArray[np.uint32],
    left_slope: NDArray[np.int16],
    right_slope: NDArray[np.int16],
    low: int,
    slope_limit: int,
    radius: int,
    start: int,
    stop: int,
    out: NDArray[np.uint8],
) -> None:
    """Fill `out` (stop - start, W, D) with the cost of image rows start to stop, averaged over a square window.

    Matches outside the right image take its border pixel; the window is continued beyond the border by replicating rows
    and columns. Units: `COST_UNITS` per bit.
    """
    rows, columns = left_bits.shape
    count = out.shape[2]
    side = 2 * radius + 1
    # A quarter of the factor, for four times the sum, fits 16 bits whatever the window.
    factor = np.uint16(round(65536.0 * COST_UNITS / 8.0 / (side * side)))
    limit = np.int16(slope_limit)
    widest = COST_BLOCK + 2 * radius
    ring = np.empty((side, widest, count), np.uint8)
    total = np.empty((widest + 1, count), np.int16)
    running = np.empty(count, np.int16)
    distance = np.empty(count, np.uint8)
    planes = np.empty((3, widest + count), np.uint8)
    slopes = np.empty(widest + count, np.int16)
    for begin in range(0, columns, COST_BLOCK):
        width = min(begin + COST_BLOCK, columns) - begin
        last = begin + width + radius - 1
        ring[:] = np.uint8(0)
        total[:] = np.int16(0)
        for step in range(start - radius, stop + radius):
            y = min(max(step, 0), rows - 1)
            slot = (step - start + radius) % side
            _mirror(right_bits[y], right_slope[y], last - low, planes, slopes)
            for k in range(width + 2 * radius):
                x = min(max(begin - radius + k, 0), columns - 1)
                first = last - x
                end = first + count
                _bit_difference(
                    left_bits[y, x], planes[0, first:end], planes[1, first:end], planes[2, first:end], distance
                )
                _replace_cost(distance, left_slope[y, x], slopes[first:end], limit, ring[slot, k], total[k])
            row = step - radius - start
            if row >= 0:
                running[:] = np.int16(0)
                for k in range(side):
                    source = total[k]
                    for d in range(count):
                        running[d] = np.int16(running[d] + source[d])
                for k in range(width):
                    _slide(running, total[k + side], total[k], factor, out[row, begin + k])
