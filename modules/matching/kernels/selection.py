"""Choice of the disparity from the aggregated cost."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from modules.matching.kernels.compiler import kernel, part
from modules.matching.kernels.vectors import (
    LANES,
    first_equal,
    least,
    load,
    ramp,
    smaller,
    store,
    where_smaller,
    words_of,
)

UNLOCKING = 0.8  # how far offsets are moved from whole pixels: t + UNLOCKING t (1 - t)^2 for t = 2 |offset|
PARABOLA, EQUIANGULAR, UNLOCKED = 0, 1, 2  # curves of `select_rows`
NOTHING = 65535  # no cost


@part
def _least_of(total: NDArray[np.uint16], at: int, count: int) -> Any:
    """Return the least of `count` costs."""
    best = words_of(np.uint16(NOTHING))
    for d in range(0, count, LANES):
        best = smaller(best, load(total, at + d))
    return least(best)


@part
def _index_of(total: NDArray[np.uint16], at: int, count: int, value: np.uint16) -> int:
    """Return the first index of a cost that is there."""
    wanted = words_of(value)
    for d in range(0, count, LANES):
        lane = first_equal(load(total, at + d), wanted)
        if lane < LANES:
            return d + lane
    return 0


@part
def _second_of(total: NDArray[np.uint16], at: int, count: int, index: int) -> int:
    """Return the least cost away from an index and its neighbours."""
    best, nothing, three = words_of(np.uint16(NOTHING)), words_of(np.uint16(NOTHING)), words_of(np.uint16(3))
    for d in range(0, count, LANES):
        beyond = ramp(np.uint16(d + 1 - index))  # 0, 1 and 2 at the index and its neighbours
        best = smaller(best, where_smaller(beyond, three, nothing, load(total, at + d)))
    return int(least(best))


@part
def _offer(
    total: NDArray[np.uint16],
    at: int,
    count: int,
    best: NDArray[np.uint16],
    index: NDArray[np.uint16],
    place: int,
) -> None:
    """Offer the costs of a left pixel to the right pixels that it may match, which keep the least."""
    for d in range(0, count, LANES):
        value, held = load(total, at + d), load(best, place + d)
        store(index, place + d, where_smaller(value, held, ramp(np.uint16(d)), load(index, place + d)))
        store(best, place + d, smaller(value, held))


@kernel
def _select_row(
    total: NDArray[np.uint16],
    searched: int,
    low: int,
    curve: int,
    disparity: NDArray[np.float32],
    ratio: NDArray[np.float32],
    right_begin: int,
    right: NDArray[np.float32],
    right_cost: NDArray[np.float32],
) -> None:
    """Do for one row what `select_rows` does."""
    columns = disparity.shape[0]
    count = total.shape[0] // columns
    # Index j holds right column `columns - 1 - low - j`, so that rising disparity walks forward through memory.
    best_right = np.full(columns + count, NOTHING, np.uint16)
    index_right = np.full(columns + count, NOTHING, np.uint16)
    for x in range(columns):
        at = x * count
        best = _least_of(total, at, count)
        index = _index_of(total, at, count, best)
        second = _second_of(total, at, count, index)
        offset = 0.0
        if 0 < index < searched - 1:
            before = float(total[at + index - 1]) - float(best)
            after = float(total[at + index + 1]) - float(best)
            span = before + after if curve == PARABOLA else max(before, after)
            offset = 0.5 * (before - after) / span if span > 0 else 0.0
            if curve == UNLOCKED:
                rest = 1.0 - 2.0 * abs(offset)
                offset += UNLOCKING * offset * rest * rest
        disparity[x] = np.float32(low + index + offset)
        flat = second == best or searched <= 3
        if flat:
            for d in range(searched):
                flat = flat and total[at + d] == best
        ratio[x] = np.float32(np.nan) if flat else np.float32((float(second) + 1.0) / (float(best) + 1.0))
        _offer(total, at, count, best_right, index_right, columns - 1 - x)
    for k in range(right.shape[0]):
        x = right_begin + k
        j = columns - 1 - low - x
        index = int(index_right[j]) if 0 <= j < columns + count else NOTHING
        if index >= searched:
            right[k] = np.float32(np.nan)
            right_cost[k] = np.float32(np.inf)
            continue
        right_cost[k] = np.float32(best_right[j])
        offset = 0.0
        xl = x + low + index
        if 0 < index < searched - 1 and 0 < xl < columns - 1:
            at = xl * count + index
            middle = float(total[at])
            before = float(total[at - count - 1]) - middle
            after = float(total[at + count + 1]) - middle
            if before >= 0 and after >= 0 and before + after > 0:
                offset = 0.5 * (before - after) / (before + after)
        right[k] = np.float32(low + index + offset)


@kernel
def select_rows(
    totals: NDArray[np.uint16],
    searched: int,
    low: int,
    curve: int,
    disparity: NDArray[np.float32],
    ratio: NDArray[np.float32],
    right_begin: int,
    right: NDArray[np.float32],
    right_cost: NDArray[np.float32],
) -> None:
    """Choose the disparity of least aggregated cost, left and right, to a fraction of a pixel.

    Parameters
    ----------
    totals : uint16 (h, W * D)
        Aggregated cost; D in whole vectors; those after the disparities searched are larger than all others.
    searched : int
        Disparities searched, at most D.
    low : int
        Disparity of index 0, px.
    curve : int
        `PARABOLA`; `EQUIANGULAR`, two lines of opposite slope; or `UNLOCKED`, these with the offset moved away from the
        whole pixels that it prefers.
    disparity, ratio : float32 (h, W)
        Filled: disparity in px, and the least cost away from the found disparity over the found one (1 means ambiguous;
        NaN where the cost is flat).
    right_begin : int
        Column of the right image where the next two begin.
    right, right_cost : float32 (h, R)
        Filled: disparity of the right image in px, NaN where no left pixel reaches, and its cost, infinite there.
    """
    for row in range(disparity.shape[0]):
        _select_row(
            totals[row], searched, low, curve, disparity[row], ratio[row], right_begin, right[row], right_cost[row]
        )
