"""Choice of the disparity from the aggregated cost."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from modules.matching.kernels.compiler import kernel

UNLOCKING = 0.8  # how far offsets are moved from whole pixels: t + UNLOCKING t (1 - t)^2 for t = 2 |offset|
PARABOLA, EQUIANGULAR, UNLOCKED = 0, 1, 2  # curves of `select`


@kernel
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


@kernel
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


@kernel
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
