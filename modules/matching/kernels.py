"""Compiled kernels of the semi-global matcher; imported only when it runs, because numba takes long to import.

All arithmetic is cast explicitly: numba makes int64 of small integers, and uint64 of differences of unsigned ones. The
inner loops run over the disparities, touch few arrays and have no branch, so that the compiler makes vector code of
them; they see slices, because an index that may be negative prevents it. The kernels release the GIL and use no threads
of their own.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba.extending import intrinsic
from numpy.typing import NDArray

_jit = numba.njit(cache=True, nogil=True, boundscheck=False)

CENSUS_RADIUS = 2  # 5x5 window, 24 comparisons
COST_UNITS = 6.25  # stored cost per bit of Hamming distance; the largest, 39.5, still fits uint8
COST_BLOCK = 64  # columns whose cost is averaged at a time, so that the sums stay in the cache
LANES = 16  # volumes hold a multiple of this many disparities, because a remainder would be worked off one by one
PADDING = 255  # cost of the disparities added for that; larger than any other, so that none is ever the best
HUGE = 16000  # path cost beyond the ends of the range
# Refinement by intensities; the values suit rendered terrain and the development pairs alike.
UNLOCKING = 0.8  # how far offsets are moved from whole pixels: t + UNLOCKING t (1 - t)^2 for t = 2 |offset|
REFINE_RADIUS = 2  # px
SMOOTH_LIMIT = 0.25  # largest change by the mean of the neighbours, px
STEP_LIMIT = 0.3  # largest change by the intensities, px
LEAST_GAIN = 0.25  # least ratio of contrast between the images, and inverse of the largest
PRIOR_SIGMA = 0.1  # expected error before the step, px
NOISE_VARIANCE = 1.0  # least variance of an intensity, DN^2
MISFIT_WEIGHT = 5.0  # counts the remaining misfit as noise; more than 1, because neighbours err alike
PARABOLA, EQUIANGULAR, UNLOCKED = 0, 1, 2  # curves of `select`


def _count_bits(typing_context: Any, value: Any) -> Any:
    """Count the bits that are set; the compiler knows a vector instruction for it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return value(value), generate


_popcount: Any = intrinsic(_count_bits)


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


@_jit
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


@_jit
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


@_jit
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


@_jit
def _follow(
    old: NDArray[np.int16],
    least: np.int16,
    jump: np.int16,
    step: np.int16,
    cost: NDArray[np.uint8],
    new: NDArray[np.int16],
    total: NDArray[np.int16],
) -> np.int16:
    """Continue one path by one pixel, add its cost to `total` (D,) and return its least cost.

    `old` and `new` (D + 2,) have a border cell at either end, which spares the tests there.
    """
    count = total.shape[0]
    before = old[:count]
    middle = old[1 : count + 1]
    after = old[2 : count + 2]
    target = new[1 : count + 1]
    best = np.int16(HUGE)
    jump = np.int16(least + jump)
    for d in range(count):
        value = np.int16(min(before[d], after[d]) + step)
        value = min(min(value, middle[d]), jump)
        value = np.int16(np.int16(value - least) + np.int16(cost[d]))
        target[d] = value
        total[d] = np.int16(total[d] + value)
        best = min(best, value)
    return best


@_jit
def aggregate(
    cost: NDArray[np.uint8],
    searched: int,
    gray: NDArray[np.int32],
    p1: int,
    p2_of_step: NDArray[np.int16],
    backward: bool,
    begin: int,
    end: int,
    paths: NDArray[np.int16],
    least: NDArray[np.int16],
    out: NDArray[np.int16],
) -> None:
    """Add the costs of four paths to rows of `out` (H, W, D).

    Forward: from the left, upper left, top and upper right. Backward: the same from the opposite side.

    Parameters
    ----------
    cost : uint8 (H, W, D)
    searched : int
        Disparities searched, at most D; those after them cost `PADDING` and do not influence the others.
    gray : int32 (H, W)
        0-255; selects P2 by the absolute step along the path.
    p1 : int
    p2_of_step : int16 (256,)
    backward : bool
    begin, end : int
        Rows of the sweep, counted from the row where it starts; a sweep may be continued by a second call.
    paths : int16 (2, 3, W + 2, D + 2)
        State of the sweep from `start_paths`; holds the three paths of the row before.
    least : int16 (2, 3, W + 2)
        Their least costs, zero at first.
    out : int16 (H, W, D)
    """
    rows, columns, count = cost.shape
    step = np.int16(p1)
    beside = np.zeros((2, count + 2), np.int16)
    for k in range(2):
        beside[k, 0] = beside[k, count + 1] = np.int16(HUGE)
    sign = -1 if backward else 1
    for i in range(begin, end):
        y = rows - 1 - i if backward else i
        yp = min(max(y - sign, 0), rows - 1)
        above = paths[i % 2]
        below = paths[(i + 1) % 2]
        above_least = least[i % 2]
        below_least = least[(i + 1) % 2]
        beside[0, 1 : count + 1] = np.int16(0)
        beside_least = np.int16(0)
        for j in range(columns):
            x = columns - 1 - j if backward else j
            here = gray[y, x]
            xa = min(max(x - sign, 0), columns - 1)
            xb = min(max(x + sign, 0), columns - 1)
            c = cost[y, x]
            s = out[y, x]
            jump = p2_of_step[abs(here - gray[y, xa])]
            target = beside[(j + 1) % 2]
            beside_least = _follow(beside[j % 2], beside_least, jump, step, c, target, s)
            target[searched + 1] = np.int16(HUGE)
            for k in range(3):
                xp = xa if k == 0 else (x if k == 1 else xb)
                at = x + 1 + (k - 1) * sign
                jump = p2_of_step[abs(here - gray[yp, xp])]
                target = below[k, x + 1]
                below_least[k, x + 1] = _follow(above[k, at], above_least[k, at], jump, step, c, target, s)
                target[searched + 1] = np.int16(HUGE)


@_jit
def start_paths(paths: NDArray[np.int16], least: NDArray[np.int16]) -> None:
    """Set the state of a sweep to that before its first row."""
    paths[:] = np.int16(0)
    paths[:, :, :, 0] = np.int16(HUGE)
    paths[:, :, :, paths.shape[3] - 1] = np.int16(HUGE)
    least[:] = np.int16(0)


@_jit
def _best_of(s: NDArray[np.int16]) -> Any:
    """Return the index of the least cost (D,), it, the second least away from it, and the largest."""
    count = s.shape[0]
    best = np.int16(32767)
    worst = np.int16(-32768)
    for d in range(count):
        best = min(best, s[d])
        worst = max(worst, s[d])
    at = np.int16(32767)
    for d in range(count):
        here = np.int16(32767)
        if s[d] == best:
            here = np.int16(d)
        at = min(at, here)
    index = np.int64(at)
    low = index - 1 if index > 0 else index
    high = index + 1 if index < count - 1 else index
    before = s[low]
    after = s[high]
    s[low] = s[index] = s[high] = np.int16(32767)
    second = np.int16(32767)
    for d in range(count):
        second = min(second, s[d])
    s[low] = before
    s[high] = after
    s[index] = best
    return index, int(best), int(second), int(worst)


@_jit
def _offer(s: NDArray[np.int16], begin: int, best: NDArray[np.int16], index: NDArray[np.int16]) -> None:
    """Offer the costs `s` of disparities from `begin` to as many right pixels, which keep the least."""
    for d in range(s.shape[0]):
        value = s[d]
        held = best[d]
        kept = index[d]
        if value < held:
            kept = np.int16(begin + d)
        best[d] = min(value, held)
        index[d] = kept


@_jit
def select(
    total: NDArray[np.int16],
    count: int,
    first: int,
    low: int,
    curve: int,
    disparity: NDArray[np.float32],
    right: NDArray[np.float32],
    ratio: NDArray[np.float32],
) -> None:
    """Choose the disparity of least aggregated cost, left and right, to a fraction of a pixel.

    Parameters
    ----------
    total : int16 (H, W, D)
        Aggregated cost.
    count : int
        Disparities searched, at most D.
    first : int
        First row of the volume that belongs to the product.
    low : int
        Disparity of index 0, px.
    curve : int
        `PARABOLA`; `EQUIANGULAR`, two lines of opposite slope; or `UNLOCKED`, these with the offset moved away from the
        whole pixels that it prefers.
    disparity, right, ratio : float32 (h, W)
        Filled: left and right disparity in px (right NaN where no left pixel reaches), and the least cost away from the
        found disparity over the found one (1 means ambiguous; NaN where the cost is flat).
    """
    rows = disparity.shape[0]
    columns = total.shape[1]
    # Index j holds right column `columns - 1 - j`, so that rising disparity walks forward through memory.
    best_right = np.empty(columns, np.int16)
    index_right = np.empty(columns, np.int16)
    for i in range(rows):
        y = first + i
        best_right[:] = np.int16(32767)
        index_right[:] = np.int16(-1)
        for x in range(columns):
            s = total[y, x][:count]
            at, best, second, worst = _best_of(s)
            offset = 0.0
            if 0 < at < count - 1:
                before = float(s[at - 1]) - float(best)
                after = float(s[at + 1]) - float(best)
                scale = before + after if curve == PARABOLA else max(before, after)
                offset = 0.5 * (before - after) / scale if scale > 0 else 0.0
                if curve == UNLOCKED:
                    rest = 1.0 - 2.0 * abs(offset)
                    offset += UNLOCKING * offset * rest * rest
            disparity[i, x] = np.float32(low + at + offset)
            if worst == best:
                ratio[i, x] = np.float32(np.nan)
            else:
                ratio[i, x] = np.float32((float(second) + 1.0) / (float(best) + 1.0))
            begin = max(x - low - columns + 1, 0)
            end = min(x - low + 1, count)
            if begin < end:
                shift = columns - 1 - x + low
                _offer(
                    s[begin:end],
                    begin,
                    best_right[begin + shift : end + shift],
                    index_right[begin + shift : end + shift],
                )
        for x in range(columns):
            at = int(index_right[columns - 1 - x])
            if at < 0:
                right[i, x] = np.float32(np.nan)
                continue
            offset = 0.0
            xl = x + low + at
            if 0 < at < count - 1 and 0 < xl < columns - 1:
                middle = float(total[y, xl, at])
                before = float(total[y, xl - 1, at - 1]) - middle
                after = float(total[y, xl + 1, at + 1]) - middle
                if before >= 0 and after >= 0 and before + after > 0:
                    offset = 0.5 * (before - after) / (before + after)
            right[i, x] = np.float32(low + at + offset)


@_jit
def smooth_rows(disparity: NDArray[np.float32], start: int, stop: int, out: NDArray[np.float32]) -> None:
    """Fill rows of `out` with disparities moved towards the mean of their neighbours, at most by `SMOOTH_LIMIT`.

    Only neighbours of similar disparity count, and near an edge, where they are few, they count less.
    """
    rows, columns = disparity.shape
    one, zero = np.float32(1.0), np.float32(0.0)
    number = np.empty(columns, np.float32)
    total = np.empty(columns, np.float32)
    for y in range(start, stop):
        number[:] = zero
        total[:] = zero
        for dy in range(-REFINE_RADIUS, REFINE_RADIUS + 1):
            yy = y + dy
            if yy < 0 or yy >= rows:
                continue
            for dx in range(-REFINE_RADIUS, REFINE_RADIUS + 1):
                begin, end = max(0, -dx), min(columns, columns - dx)
                here = disparity[y, begin:end]
                there = disparity[yy, begin + dx : end + dx]
                n = number[begin:end]
                s = total[begin:end]
                for x in range(here.shape[0]):
                    step = there[x] - here[x]
                    weight = one if abs(step) < one else zero
                    n[x] += weight
                    s[x] += weight * step
        limit = np.float32(SMOOTH_LIMIT)
        square = np.float32((2 * REFINE_RADIUS + 1) ** 4)
        for x in range(columns):
            out[y, x] = disparity[y, x] + min(max(total[x] * number[x] / square, -limit), limit)


@_jit
def fit_rows(
    left: NDArray[np.float32],
    right: NDArray[np.float32],
    slope: NDArray[np.float32],
    disparity: NDArray[np.float32],
    start: int,
    stop: int,
    out: NDArray[np.float32],
) -> None:
    """Fill rows of `out` with the disparity moved by one damped Gauss-Newton step.

    Model in a window: left = gain (right - slope step) + offset, over the neighbours of similar disparity.

    Parameters
    ----------
    left, right : float32 (H, W)
        Intensities, the right ones warped by `disparity`, DN.
    slope : float32 (H, W)
        Derivative of the right image there, DN/px.
    disparity : float32 (H, W)
        px.
    start, stop : int
    out : float32 (H, W)
    """
    rows, columns = disparity.shape
    one, zero = np.float32(1.0), np.float32(0.0)
    sums = np.empty((10, columns), np.float32)
    for y in range(start, stop):
        sums[:] = zero
        for dy in range(-REFINE_RADIUS, REFINE_RADIUS + 1):
            yy = y + dy
            if yy < 0 or yy >= rows:
                continue
            for dx in range(-REFINE_RADIUS, REFINE_RADIUS + 1):
                begin, end = max(0, -dx), min(columns, columns - dx)
                d0, l0, r0 = disparity[y, begin:end], left[y, begin:end], right[y, begin:end]
                d1 = disparity[yy, begin + dx : end + dx]
                l1 = left[yy, begin + dx : end + dx]
                r1 = right[yy, begin + dx : end + dx]
                g1 = slope[yy, begin + dx : end + dx]
                part = sums[:, begin:end]
                for x in range(d0.shape[0]):
                    weight = one if abs(d1[x] - d0[x]) < one else zero
                    a = weight * (l1[x] - l0[x])  # from the centre, so that sums of squares stay exact
                    b = weight * (r1[x] - r0[x])
                    c = weight * g1[x]
                    part[0, x] += weight
                    part[1, x] += a
                    part[2, x] += b
                    part[3, x] += c
                    part[4, x] += a * a
                    part[5, x] += b * b
                    part[6, x] += c * c
                    part[7, x] += a * b
                    part[8, x] += a * c
                    part[9, x] += b * c
        for x in range(columns):
            n = sums[0, x]
            aa = sums[4, x] - sums[1, x] * sums[1, x] / n
            bb = sums[5, x] - sums[2, x] * sums[2, x] / n
            cc = sums[6, x] - sums[3, x] * sums[3, x] / n
            ab = sums[7, x] - sums[1, x] * sums[2, x] / n
            ac = sums[8, x] - sums[1, x] * sums[3, x] / n
            bc = sums[9, x] - sums[2, x] * sums[3, x] / n
            gain = one
            determinant = bb * cc - bc * bc
            if determinant > np.float32(1e-3) * bb * cc:
                gain = (ab * cc - ac * bc) / determinant
                gain = min(max(gain, np.float32(LEAST_GAIN)), np.float32(1.0 / LEAST_GAIN))
            pull = gain * (gain * bc - ac)
            hold = gain * gain * cc
            misfit = aa - np.float32(2.0) * gain * ab + gain * gain * bb
            if hold > np.float32(1e-6):
                misfit -= pull * pull / hold
            variance = np.float32(NOISE_VARIANCE) + np.float32(MISFIT_WEIGHT) * max(misfit, zero) / n
            step = pull / (hold + variance / np.float32(PRIOR_SIGMA * PRIOR_SIGMA))
            out[y, x] = disparity[y, x] + min(max(step, np.float32(-STEP_LIMIT)), np.float32(STEP_LIMIT))
