"""Matching cost of the semi-global matcher: bits that differ and values that differ, averaged over a window.

Every cost has this form. Census transforms give the bits; the horizontal derivative or the intensity gives the value.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modules.matching.kernels.compiler import kernel, part
from modules.matching.kernels.vectors import (
    LANES,
    add,
    bytes_of,
    count_bits,
    either,
    larger,
    load,
    narrow,
    ramp,
    scale,
    shift_left,
    smaller,
    store,
    subtract,
    where_smaller,
    widen,
    words_of,
)

BLOCK = 128  # columns whose cost is averaged at a time, so that the sums stay in the cache
PADDING = 255  # cost of disparities that are not searched; larger than any other, so that none is ever the best


@part
def _replace_costs(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    at: int,
    plane: int,
    bit_shift: int,
    limit: int,
    held: NDArray[np.uint8],
    held_at: int,
    column: NDArray[np.uint16],
    column_at: int,
    count: int,
) -> None:
    """Put the costs of one pixel in the place of others, and their change into the sums of its column."""
    words = left.shape[0] - 1
    value = bytes_of(left[words])
    most = bytes_of(np.uint8(limit))
    weight = bytes_of(np.uint8(bit_shift))
    three = words >= 3
    word0, word1, word2 = bytes_of(left[0]), bytes_of(left[1 % (words + 1)]), bytes_of(left[2 % (words + 1)])
    for d in range(0, count, LANES):
        other = load(right, at + words * plane + d)
        bits = bytes_of(np.uint8(0))
        if three:
            bits = count_bits(either(load(right, at + d), word0))
            bits = add(bits, count_bits(either(load(right, at + plane + d), word1)))
            bits = add(bits, count_bits(either(load(right, at + 2 * plane + d), word2)))
        for k in range(3 if three else 0, words):
            bits = add(bits, count_bits(either(load(right, at + k * plane + d), bytes_of(left[k]))))
        difference = smaller(subtract(larger(value, other), smaller(value, other)), most)
        cost = add(shift_left(bits, weight), difference)
        old = load(held, held_at + d)
        store(held, held_at + d, cost)
        total = load(column, column_at + d)
        store(column, column_at + d, add(subtract(total, widen(old)), widen(cost)))


@part
def _slide(
    running: NDArray[np.uint16],
    column: NDArray[np.uint16],
    enter: int,
    leave: int,
    shift: int,
    factor: int,
    limit: int,
    out: NDArray[np.uint8],
    at: int,
    count: int,
    searched: int,
) -> None:
    """Write the mean of the window in `running`, then move it by one column."""
    by, times, most = words_of(np.uint16(shift)), words_of(np.uint16(factor)), words_of(np.uint16(limit))
    end, padding = words_of(np.uint16(searched)), words_of(np.uint16(PADDING))
    for d in range(0, count, LANES):
        total = load(running, d)
        cost = smaller(scale(shift_left(total, by), times), most)
        store(out, at + d, narrow(where_smaller(ramp(np.uint16(d)), end, cost, padding)))
        store(running, d, subtract(add(total, load(column, enter + d)), load(column, leave + d)))


@kernel
def cost_rows(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    before: int,
    searched: int,
    bit_shift: int,
    value_limit: int,
    radius: int,
    levels: float,
    most: int,
    start: int,
    stop: int,
    out: NDArray[np.uint8],
) -> None:
    """Fill `out` with the cost of image rows start to stop.

    Matches outside the right image take its border pixel; the window is continued beyond the border by replicating rows
    and columns.

    Parameters
    ----------
    left : uint8 (H, W, K + 1)
        K bytes of bits and a value.
    right : uint8 (K + 1, H, L)
        The same of the right image, from right to left and continued, so that index `before + d` of a row holds what
        the first left pixel is compared with at disparity index d, and one less what the next one is.
    before : int
        At least W - 1; L is at least `before` + D.
    searched : int
        Disparities searched, at most D; the cost of the others is `PADDING`.
    bit_shift, value_limit : int
        A pixel costs `bits << bit_shift` plus the difference of the values, at most `value_limit`.
    radius : int
        Of the window, px.
    levels : float
        Stored cost per unit of that.
    most : int
        Largest cost stored, at most 254.
    start, stop : int
    out : uint8 (stop - start, W * D)
        D in whole vectors.
    """
    rows, columns, planes = left.shape
    count = out.shape[1] // columns
    side = 2 * radius + 1
    largest = side * side * ((8 * (planes - 1) << bit_shift) + value_limit)
    shift = 0
    while (largest << (shift + 1)) < 65536:
        shift += 1
    factor = min(round(65536.0 * levels / (side * side * (1 << shift))), 65535)
    widest = BLOCK + 2 * radius
    length = right.shape[2]
    mirrored = right.reshape(right.size)
    held = np.empty(side * widest * count, np.uint8)
    column = np.empty((widest + 1) * count, np.uint16)
    running = np.empty(count, np.uint16)
    for begin in range(0, columns, BLOCK):
        width = min(begin + BLOCK, columns) - begin
        held[:] = np.uint8(0)
        column[:] = np.uint16(0)
        for step in range(start - radius, stop + radius):
            y = min(max(step, 0), rows - 1)
            slot = (step - start + radius) % side * widest
            for k in range(width + 2 * radius):
                x = min(max(begin - radius + k, 0), columns - 1)
                at = y * length + before - x
                spot = (slot + k) * count
                _replace_costs(
                    left[y, x],
                    mirrored,
                    at,
                    rows * length,
                    bit_shift,
                    value_limit,
                    held,
                    spot,
                    column,
                    k * count,
                    count,
                )
            row = step - radius - start
            if row < 0:
                continue
            running[:] = np.uint16(0)
            for k in range(side):
                for d in range(0, count, LANES):
                    store(running, d, add(load(running, d), load(column, k * count + d)))
            for k in range(width):
                at = (begin + k) * count
                _slide(
                    running, column, (k + side) * count, k * count, shift, factor, most, out[row], at, count, searched
                )


@kernel
def shift_windows(
    cost: NDArray[np.uint8], begin: int, end: int, radius: int, columns: int, out: NDArray[np.uint8]
) -> None:
    """Take the least cost of the windows around each pixel, so that a window may lie on one side of an edge.

    Parameters
    ----------
    cost : uint8 (h, W * D)
        D in whole vectors.
    begin, end : int
        Rows of `cost` that are wanted; rows and columns beyond it are not asked.
    radius : int
        How far a window is shifted at most, px.
    columns : int
        W.
    out : uint8 (end - begin, W * D)
    """
    size = cost.shape[1]
    count = size // columns
    lines = np.empty(size, np.uint8)
    for row in range(begin, end):
        top, bottom = max(row - radius, 0), min(row + radius, cost.shape[0] - 1)
        for at in range(0, size, LANES):
            best = load(cost[top], at)
            for y in range(top + 1, bottom + 1):
                best = smaller(best, load(cost[y], at))
            store(lines, at, best)
        for x in range(columns):
            first, last = max(x - radius, 0), min(x + radius, columns - 1)
            for d in range(0, count, LANES):
                best = load(lines, first * count + d)
                for k in range(first + 1, last + 1):
                    best = smaller(best, load(lines, k * count + d))
                store(out[row - begin], x * count + d, best)
