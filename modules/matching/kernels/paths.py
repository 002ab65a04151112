"""Sums of path costs over the volume of the semi-global matcher."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modules.matching.kernels.compiler import kernel

HUGE = 16000  # path cost beyond the ends of the range


@kernel
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


@kernel
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


@kernel
def start_paths(paths: NDArray[np.int16], least: NDArray[np.int16]) -> None:
    """Set the state of a sweep to that before its first row."""
    paths[:] = np.int16(0)
    paths[:, :, :, 0] = np.int16(HUGE)
    paths[:, :, :, paths.shape[3] - 1] = np.int16(HUGE)
    least[:] = np.int16(0)
