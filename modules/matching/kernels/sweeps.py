"""Path costs of the semi-global matcher, row by row, in bytes.

A sweep walks over the rows of the image, downwards or upwards, and carries three paths from the row before and one
along the row. The path costs are bytes: the largest cost and the largest penalty together stay below 255.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from modules.matching.kernels.compiler import kernel, part
from modules.matching.kernels.vectors import (
    LANES,
    add,
    add_clipped,
    bytes_of,
    least,
    load,
    mean,
    smaller,
    store,
    subtract,
    widen,
)

CARRY, KEEP, JOIN = 0, 1, 2  # what becomes of a row: only the state is carried on, its sums are kept, or joined


@part
def _step(old: Any, at: int, penalty: Any, jump: Any, base: Any) -> Any:
    """Return the least cost of arriving at 32 disparities, above the least of the pixel before."""
    beside = smaller(load(old, at), load(old, at + 2))
    return subtract(smaller(smaller(add_clipped(beside, penalty), load(old, at + 1)), jump), base)


@kernel
def sweep_row(
    cost: NDArray[np.uint8],
    steps: NDArray[np.uint8],
    backward: bool,
    diagonals: bool,
    p1_of_step: NDArray[np.uint8],
    p2_of_step: NDArray[np.uint8],
    old: NDArray[np.uint8],
    old_least: NDArray[np.uint8],
    new: NDArray[np.uint8],
    new_least: NDArray[np.uint8],
    along: NDArray[np.uint8],
    mode: int,
    kept: NDArray[np.uint8],
    total: NDArray[np.uint16],
) -> None:
    """Carry four paths, or two without the diagonals, over one row.

    Parameters
    ----------
    cost : uint8 (W * D,)
        D in whole vectors.
    steps : uint8 (4, W)
        Step of the guide image from the pixel before, which selects the penalties, along each path: in the row, from
        the corner behind, from the row before, from the corner ahead.
    backward : bool
        Walk from the last column to the first; the row before is then the one below.
    diagonals : bool
    p1_of_step, p2_of_step : uint8 (256,)
    old, new : uint8 ((W + 2) * 3 * (D + 2),)
        Path costs of the row before and, filled, of this one. The cells at the ends of the range hold 255, the columns
        beyond the border 0.
    old_least, new_least : uint8 (W + 2, 3)
        Their least values.
    along : uint8 (2 * (D + 2),)
        Room for the path along the row; 255 at the ends.
    mode : int
        `CARRY`, `KEEP` or `JOIN`.
    kept : uint8 (W * D,)
        Mean over the paths of the least cost of arriving, above the least of the pixel before: written by `KEEP`, and
        read by `JOIN`, which expects it from the other sweep.
    total : uint16 (W * D,)
        Written by `JOIN`: the means of both sweeps and twice the cost.
    """
    columns = steps.shape[1]
    count = cost.shape[0] // columns
    cell = count + 2
    sign = -1 if backward else 1
    along[1 : count + 1] = np.uint8(0)
    least0 = np.uint8(0)
    for j in range(columns):
        x = columns - 1 - j if backward else j
        from0, to0 = (j % 2) * cell, ((j + 1) % 2) * cell
        to = (x + 1) * 3 * cell
        from1 = to - sign * 3 * cell
        from2 = to + cell
        from3 = to + sign * 3 * cell + 2 * cell
        least1, least2, least3 = old_least[x + 1 - sign, 0], old_least[x + 1, 1], old_least[x + 1 + sign, 2]
        step0, step1, step2, step3 = steps[0, x], steps[1, x], steps[2, x], steps[3, x]
        jump0, penalty0 = bytes_of(np.uint8(least0 + p2_of_step[step0])), bytes_of(p1_of_step[step0])
        jump1, penalty1 = bytes_of(np.uint8(least1 + p2_of_step[step1])), bytes_of(p1_of_step[step1])
        jump2, penalty2 = bytes_of(np.uint8(least2 + p2_of_step[step2])), bytes_of(p1_of_step[step2])
        jump3, penalty3 = bytes_of(np.uint8(least3 + p2_of_step[step3])), bytes_of(p1_of_step[step3])
        base0, base1, base2, base3 = bytes_of(least0), bytes_of(least1), bytes_of(least2), bytes_of(least3)
        best0 = best1 = best2 = best3 = bytes_of(np.uint8(255))
        for d in range(0, count, LANES):
            c = load(cost, x * count + d)
            v0 = _step(along, from0 + d, penalty0, jump0, base0)
            n0 = add_clipped(v0, c)
            store(along, to0 + d + 1, n0)
            best0 = smaller(best0, n0)
            v2 = _step(old, from2 + d, penalty2, jump2, base2)
            n2 = add_clipped(v2, c)
            store(new, to + cell + d + 1, n2)
            best2 = smaller(best2, n2)
            v = mean(v0, v2)
            if diagonals:
                v1 = _step(old, from1 + d, penalty1, jump1, base1)
                n1 = add_clipped(v1, c)
                store(new, to + d + 1, n1)
                best1 = smaller(best1, n1)
                v3 = _step(old, from3 + d, penalty3, jump3, base3)
                n3 = add_clipped(v3, c)
                store(new, to + 2 * cell + d + 1, n3)
                best3 = smaller(best3, n3)
                v = mean(v, mean(v1, v3))
            if mode == KEEP:
                store(kept, x * count + d, v)
            elif mode == JOIN:
                once = widen(c)
                both = add(widen(v), widen(load(kept, x * count + d)))
                store(total, x * count + d, add(both, add(once, once)))
        least0 = least(best0)
        new_least[x + 1, 1] = least(best2)
        if diagonals:
            new_least[x + 1, 0] = least(best1)
            new_least[x + 1, 2] = least(best3)


@kernel
def sweep_rows(
    cost: NDArray[np.uint8],
    cost_top: int,
    steps: NDArray[np.uint8],
    begin: int,
    end: int,
    backward: bool,
    diagonals: bool,
    p1_of_step: NDArray[np.uint8],
    p2_of_step: NDArray[np.uint8],
    paths: NDArray[np.uint8],
    least_paths: NDArray[np.uint8],
    along: NDArray[np.uint8],
    mode: int,
    kept: NDArray[np.uint8],
    kept_top: int,
    total: NDArray[np.uint16],
) -> None:
    """Carry a sweep over rows.

    Parameters
    ----------
    cost : uint8 (h, W * D)
        Of the rows from `cost_top`.
    steps : uint8 (4, H, W)
    begin, end : int
        Counted from the row where the sweep starts.
    paths, least_paths : uint8 (2, (W + 2) * 3 * (D + 2)), uint8 (2, W + 2, 3)
        State of the sweep: where `begin` is even, the first holds the row before.
    kept : uint8 (h, W * D)
        Of the rows from `kept_top`.
    total : uint16 (end - begin, W * D)
        In the order of the image, as everything.
    """
    rows = steps.shape[1]
    top = rows - end if backward else begin
    for i in range(begin, end):
        y = rows - 1 - i if backward else i
        old, new = i % 2, (i + 1) % 2
        sweep_row(
            cost[y - cost_top],
            steps[:, y],
            backward,
            diagonals,
            p1_of_step,
            p2_of_step,
            paths[old],
            least_paths[old],
            paths[new],
            least_paths[new],
            along,
            mode,
            kept[y - kept_top] if mode != CARRY else kept[0],
            total[y - top] if mode == JOIN else total[0],
        )
