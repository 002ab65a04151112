"""Compiled kernels of the semi-global matcher; imported only when it runs, because numba takes long to import.

All arithmetic is cast explicitly: numba makes int64 of small integers, and uint64 of differences of unsigned ones. The
kernels release the GIL and use no threads of their own.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

_jit = numba.njit(cache=True, nogil=True, boundscheck=False)

CENSUS_RADIUS = 2  # 5x5 window, 24 comparisons
COST_UNITS = 6.25  # stored cost per bit of Hamming distance; the largest, 39.5, still fits uint8


@_jit
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


@_jit
def _raw_cost_row(
    left_bits: NDArray[np.uint32],
    right_bits: NDArray[np.uint32],
    left_slope: NDArray[np.int16],
    right_slope: NDArray[np.int16],
    low: int,
    count: int,
    slope_limit: int,
    mirrored_bits: NDArray[np.uint32],
    mirrored_slope: NDArray[np.int16],
    out: NDArray[np.int16],
) -> None:
    """Fill `out` (W, D) with twice the cost of one row; matches outside the right image take its border pixel."""
    columns = left_bits.shape[0]
    # Mirrored, so that rising disparity walks forward through memory: index j holds right column `last - j`.
    last = columns - 1 - low
    for j in range(columns + count - 1):
        x = min(max(last - j, 0), columns - 1)
        mirrored_bits[j] = right_bits[x]
        mirrored_slope[j] = right_slope[x]
    limit = np.int16(slope_limit)
    for x in range(columns):
        bits = left_bits[x]
        slope = left_slope[x]
        first = columns - 1 - x
        for d in range(count):
            v = np.uint32(bits ^ mirrored_bits[first + d])
            v = np.uint32(v - np.uint32(np.uint32(v >> np.uint32(1)) & np.uint32(0x55555555)))
            v = np.uint32(
                np.uint32(v & np.uint32(0x33333333)) + np.uint32(np.uint32(v >> np.uint32(2)) & np.uint32(0x33333333))
            )
            v = np.uint32(np.uint32(v + np.uint32(v >> np.uint32(4))) & np.uint32(0x0F0F0F0F))
            v = np.uint32(np.uint32(v * np.uint32(0x01010101)) >> np.uint32(24))
            difference = np.int16(slope - mirrored_slope[first + d])
            difference = np.int16(-difference) if difference < 0 else difference
            difference = limit if difference > limit else difference
            out[x, d] = np.int16(np.int16(np.int16(v) * np.int16(2)) + difference)


@_jit
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

    The window is truncated by replicating rows and columns at the border. Units: `COST_UNITS` per bit.
    """
    rows, columns = left_bits.shape
    count = out.shape[2]
    side = 2 * radius + 1
    factor = np.int32(round(65536.0 * COST_UNITS / 2.0 / (side * side)))
    raw = np.empty((columns, count), np.int16)
    ring = np.zeros((side, columns, count), np.int16)
    total = np.zeros((columns, count), np.int16)
    running = np.zeros(count, np.int16)
    mirrored_bits = np.empty(columns + count, np.uint32)
    mirrored_slope = np.empty(columns + count, np.int16)
    for step in range(start - radius, stop + radius):
        y = min(max(step, 0), rows - 1)
        slot = (step - start + radius) % side
        _raw_cost_row(
            left_bits[y], right_bits[y], left_slope[y], right_slope[y], low, count, slope_limit, mirrored_bits,
            mirrored_slope, raw,
        )  # fmt: skip
        running[:] = np.int16(0)
        for dx in range(-radius, radius + 1):
            source = raw[min(max(dx, 0), columns - 1)]
            for d in range(count):
                running[d] = np.int16(running[d] + source[d])
        for x in range(columns):
            held = ring[slot, x]
            column = total[x]
            enter = raw[min(x + radius + 1, columns - 1)]
            leave = raw[max(x - radius, 0)]
            for d in range(count):
                value = running[d]
                column[d] = np.int16(np.int16(column[d] + value) - held[d])
                held[d] = value
                running[d] = np.int16(np.int16(value + enter[d]) - leave[d])
        row = step - radius - start
        if row >= 0:
            for x in range(columns):
                column = total[x]
                target = out[row, x]
                for d in range(count):
                    target[d] = np.uint8(np.int32(np.int32(np.int32(column[d]) * factor) >> np.int32(16)))


@_jit
def aggregate(
    cost: NDArray[np.uint8],
    gray: NDArray[np.int32],
    p1: int,
    p2_of_step: NDArray[np.int16],
    backward: bool,
    out: NDArray[np.int16],
) -> None:
    """Fill `out` (H, W, D) with the sum of four path costs.

    Forward: from the left, upper left, top and upper right. Backward: the same from the opposite side.

    Parameters
    ----------
    cost : uint8 (H, W, D)
    gray : int32 (H, W)
        0-255; selects P2 by the absolute step along the path.
    p1 : int
    p2_of_step : int16 (256,)
    backward : bool
    out : int16 (H, W, D)
    """
    rows, columns, count = cost.shape
    huge = np.int16(16000)
    small = np.int16(p1)
    # One border cell before and after the disparities spares the tests at the ends of the range.
    above = np.zeros((3, columns + 2, count + 2), np.int16)
    below = np.zeros((3, columns + 2, count + 2), np.int16)
    above_least = np.zeros((3, columns + 2), np.int16)
    below_least = np.zeros((3, columns + 2), np.int16)
    beside = np.zeros((2, count + 2), np.int16)
    for k in range(3):
        for x in range(columns + 2):
            above[k, x, 0] = above[k, x, count + 1] = huge
            below[k, x, 0] = below[k, x, count + 1] = huge
    for k in range(2):
        beside[k, 0] = beside[k, count + 1] = huge
    sign = -1 if backward else 1
    for i in range(rows):
        y = rows - 1 - i if backward else i
        yp = min(max(y - sign, 0), rows - 1)
        beside[0, 1 : count + 1] = np.int16(0)
        beside_least = np.int16(0)
        for j in range(columns):
            x = columns - 1 - j if backward else j
            here = gray[y, x]
            xa = min(max(x - sign, 0), columns - 1)
            xb = min(max(x + sign, 0), columns - 1)
            pa = p2_of_step[abs(here - gray[y, xa])]
            pb = p2_of_step[abs(here - gray[yp, xa])]
            pc = p2_of_step[abs(here - gray[yp, x])]
            pd = p2_of_step[abs(here - gray[yp, xb])]
            old = beside[j % 2]
            new = beside[(j + 1) % 2]
            ub = above[0, x + 1 - sign]
            uc = above[1, x + 1]
            ud = above[2, x + 1 + sign]
            lb = above_least[0, x + 1 - sign]
            lc = above_least[1, x + 1]
            ld = above_least[2, x + 1 + sign]
            vb = below[0, x + 1]
            vc = below[1, x + 1]
            vd = below[2, x + 1]
            c = cost[y, x]
            s = out[y, x]
            ma = huge
            mb = huge
            mc = huge
            md = huge
            for d in range(count):
                value = np.int16(c[d])

                a = np.int16(min(old[d], old[d + 2]) + small)
                a = min(a, old[d + 1])
                a = min(a, np.int16(beside_least + pa))
                a = np.int16(np.int16(a - beside_least) + value)
                new[d + 1] = a
                ma = min(ma, a)

                b = np.int16(min(ub[d], ub[d + 2]) + small)
                b = min(b, ub[d + 1])
                b = min(b, np.int16(lb + pb))
                b = np.int16(np.int16(b - lb) + value)
                vb[d + 1] = b
                mb = min(mb, b)

                e = np.int16(min(uc[d], uc[d + 2]) + small)
                e = min(e, uc[d + 1])
                e = min(e, np.int16(lc + pc))
                e = np.int16(np.int16(e - lc) + value)
                vc[d + 1] = e
                mc = min(mc, e)

                f = np.int16(min(ud[d], ud[d + 2]) + small)
                f = min(f, ud[d + 1])
                f = min(f, np.int16(ld + pd))
                f = np.int16(np.int16(f - ld) + value)
                vd[d + 1] = f
                md = min(md, f)

                s[d] = np.int16(np.int16(a + b) + np.int16(e + f))
            beside_least = ma
            below_least[0, x + 1] = mb
            below_least[1, x + 1] = mc
            below_least[2, x + 1] = md
        above, below = below, above
        above_least, below_least = below_least, above_least


@_jit
def select(
    one: NDArray[np.int16],
    two: NDArray[np.int16],
    first: int,
    low: int,
    equiangular: bool,
    disparity: NDArray[np.float32],
    right: NDArray[np.float32],
    ratio: NDArray[np.float32],
) -> None:
    """Choose the disparity of least aggregated cost, left and right, to a fraction of a pixel.

    Parameters
    ----------
    one, two : int16 (H, W, D)
        Their sum is the aggregated cost; `one` is overwritten by it.
    first : int
        First row of the volume that belongs to the product.
    low : int
        Disparity of index 0, px.
    equiangular : bool
        Fit two lines of opposite slope instead of a parabola.
    disparity, right, ratio : float32 (h, W)
        Filled: left and right disparity in px (right NaN where no left pixel reaches), and the least cost away from the
        found disparity over the found one (1 means ambiguous; NaN where the cost is flat).
    """
    rows = disparity.shape[0]
    columns, count = one.shape[1], one.shape[2]
    best_right = np.empty(columns, np.int16)
    index_right = np.empty(columns, np.int32)
    for i in range(rows):
        y = first + i
        best_right[:] = np.int16(32767)
        index_right[:] = -1
        for x in range(columns):
            s = one[y, x]
            t = two[y, x]
            best = np.int16(32767)
            for d in range(count):
                s[d] = np.int16(s[d] + t[d])
                best = min(best, s[d])
            at = 0
            while s[at] != best:
                at += 1
            worst = np.int16(0)
            second = np.int16(32767)
            for d in range(count):
                worst = max(worst, s[d])
            for d in range(at - 1):
                second = min(second, s[d])
            for d in range(at + 2, count):
                second = min(second, s[d])
            offset = 0.0
            if 0 < at < count - 1:
                before = float(s[at - 1]) - float(best)
                after = float(s[at + 1]) - float(best)
                if equiangular:
                    steep = max(before, after)
                    offset = 0.5 * (before - after) / steep if steep > 0 else 0.0
                else:
                    curve = before + after
                    offset = 0.5 * (before - after) / curve if curve > 0 else 0.0
            disparity[i, x] = np.float32(low + at + offset)
            if worst == best:
                ratio[i, x] = np.float32(np.nan)
            else:
                ratio[i, x] = np.float32((float(second) + 1.0) / (float(best) + 1.0))
            begin = max(x - low - columns + 1, 0)
            end = min(x - low + 1, count)
            for d in range(begin, end):
                xr = x - low - d
                if s[d] < best_right[xr]:
                    best_right[xr] = s[d]
                    index_right[xr] = d
        for x in range(columns):
            at = index_right[x]
            if at < 0:
                right[i, x] = np.float32(np.nan)
                continue
            offset = 0.0
            xl = x + low + at
            if 0 < at < count - 1 and 0 < xl < columns - 1:
                middle = float(one[y, xl, at])
                before = float(one[y, xl - 1, at - 1]) - middle
                after = float(one[y, xl + 1, at + 1]) - middle
                if before >= 0 and after >= 0 and before + after > 0:
                    offset = 0.5 * (before - after) / (before + after)
            right[i, x] = np.float32(low + at + offset)
