"""Compiled kernels over points and cells; imported only when they run, because numba takes long to import.

They release the GIL and use no threads of their own.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

_jit = numba.njit(cache=True, nogil=True, boundscheck=False)


@_jit
def sort_by_cell(cell: NDArray[np.int32], z: NDArray[np.float32], cells: int) -> Any:
    """Sort heights (N,) by cell, and within it.

    Returns
    -------
    start : int32 (cells + 1,)
        Where each cell begins.
    ordered : float32 (N,)
    """
    start = np.zeros(cells + 1, np.int32)
    for k in range(len(cell)):
        start[cell[k] + 1] += 1
    for c in range(cells):
        start[c + 1] += start[c]
    place = start[:-1].copy()
    ordered = np.empty(len(cell), np.float32)
    for k in range(len(cell)):
        ordered[place[cell[k]]] = z[k]
        place[cell[k]] += 1
    for c in range(cells):
        first, last = start[c], start[c + 1]
        if last - first > 48:
            ordered[first:last].sort()
        else:
            for k in range(first + 1, last):  # insertion is faster for few
                value = ordered[k]
                j = k - 1
                while j >= first and ordered[j] > value:
                    ordered[j + 1] = ordered[j]
                    j -= 1
                ordered[j + 1] = value
    return start, ordered


@_jit
def sums_of_cells(
    cell: NDArray[np.int32],
    z: NDArray[np.float32],
    variance: NDArray[np.float32],
    median: NDArray[np.float32],
    limit: NDArray[np.float32],
    outlier_sigma: float,
) -> NDArray[np.float64]:
    """Return count, sum of weights, weighted sum, sum and sum of squares (cells, 5) of the heights without outliers.

    Heights are taken from the cell's median; a point is an outlier farther from it than `outlier_sigma` times the root
    of its variance plus the cell's `limit`.
    """
    sums = np.zeros((len(median), 5))
    for k in range(len(cell)):
        c = cell[k]
        d = z[k] - median[c]
        v = variance[k]
        if d * d <= outlier_sigma * outlier_sigma * (v + limit[c]):
            w = 1.0 / v
            sums[c, 0] += 1.0
            sums[c, 1] += w
            sums[c, 2] += w * d
            sums[c, 3] += d
            sums[c, 4] += d * d
    return sums


@_jit
def count_agreeing(disparity: NDArray[np.float32], radius: int, gradient: float, tolerance: float) -> NDArray[np.int32]:
    """Count the neighbours (H, W) whose disparity differs by at most `tolerance + gradient * distance in px`.

    NaN pixels have 0 and are no neighbours.
    """
    rows, columns = disparity.shape
    found = np.zeros((rows, columns), np.int32)
    for y in range(rows):
        for yy in range(max(0, y - radius), min(rows, y + radius + 1)):
            for dx in range(-radius, radius + 1):
                reach = tolerance + gradient * max(abs(yy - y), abs(dx))
                begin, end = max(0, -dx), min(columns, columns - dx)
                if end <= begin:  # a window wider than the image
                    continue
                here, there, counts = disparity[y, begin:end], disparity[yy, begin + dx : end + dx], found[y, begin:end]
                for x in range(len(here)):  # the compiler makes vectors of this one
                    counts[x] += np.int32(abs(there[x] - here[x]) <= reach)  # 0 for NaN
        for x in range(columns):
            found[y, x] = max(found[y, x] - 1, 0)  # itself
    return found


@_jit
def nearest_difference(disparity: NDArray[np.float32], radius: int, nearest: int) -> NDArray[np.float32]:
    """Return the mean difference (H, W), px, from the `nearest` most similar neighbours; NaN where there are fewer."""
    rows, columns = disparity.shape
    result = np.full((rows, columns), np.nan, np.float32)
    best = np.empty(nearest, np.float32)
    for y in range(rows):
        for x in range(columns):
            d = disparity[y, x]
            if d != d:
                continue
            n = 0
            for yy in range(max(0, y - radius), min(rows, y + radius + 1)):
                for xx in range(max(0, x - radius), min(columns, x + radius + 1)):
                    difference = abs(disparity[yy, xx] - d)
                    if difference != difference or (yy == y and xx == x):
                        continue
                    if n == nearest and difference >= best[n - 1]:
                        continue
                    j = min(n, nearest - 1)
                    while j > 0 and best[j - 1] > difference:
                        best[j] = best[j - 1]
                        j -= 1
                    best[j] = difference
                    n = min(n + 1, nearest)
            if n == nearest:
                total = np.float32(0.0)
                for j in range(nearest):
                    total += best[j]
                result[y, x] = total / np.float32(nearest)
    return result
