"""What `kernels` does, by NumPy alone, bit for bit; two to ten times slower, for machines without numba."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

STRIP_BYTES = 64_000_000  # of the differences held at once
SIGN = np.uint32(0x80000000)


def load_kernels() -> ModuleType:
    """Return the compiled kernels, or this module where numba is not installed."""
    try:
        from modules.reconstruction import kernels
    except ModuleNotFoundError as error:
        if error.name not in ("numba", "llvmlite"):
            raise
        import modules.reconstruction.plain as kernels  # type: ignore[no-redef]
    return kernels


def sort_by_cell(
    cell: NDArray[np.int32], z: NDArray[np.float32], cells: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Sort finite heights (N,) by cell, and within it; see `kernels.sort_by_cell`.

    Notes
    -----
    Cell and height are sorted as one integer: the bits of floats are in the order of their values, once those of
    negative ones are inverted.
    """
    bits = z.view(np.uint32)
    rank = np.where(bits & SIGN, ~bits, bits | SIGN)
    key = np.sort((cell.astype(np.uint64) << np.uint64(32)) | rank)
    rank = (key & np.uint64(0xFFFFFFFF)).astype(np.uint32)
    ordered = np.where(rank & SIGN, rank ^ SIGN, ~rank).view(np.float32)
    start = np.zeros(cells + 1, np.int32)
    np.cumsum(np.bincount(cell, minlength=cells), out=start[1:])
    return start, ordered


def sums_of_cells(
    cell: NDArray[np.int32],
    z: NDArray[np.float32],
    variance: NDArray[np.float32],
    median: NDArray[np.float32],
    limit: NDArray[np.float32],
    outlier_sigma: float,
) -> NDArray[np.float64]:
    """Return count, sum of weights, weighted sum, sum and sum of squares (cells, 5); see `kernels.sums_of_cells`."""
    d = z - median[cell]
    square = d * d
    keep = square <= np.float64(outlier_sigma * outlier_sigma) * (variance + limit[cell])
    cell, d, square = cell[keep], d[keep], square[keep]
    weight = 1.0 / variance[keep].astype(np.float64)
    terms = (None, weight, weight * d, d, square)
    return np.stack([np.bincount(cell, term, len(median)).astype(np.float64) for term in terms], axis=1)


def count_agreeing(disparity: NDArray[np.float32], radius: int, gradient: float, tolerance: float) -> NDArray[np.int32]:
    """Count the neighbours (H, W) of similar disparity; see `kernels.count_agreeing`."""
    rows, columns = disparity.shape
    found = np.zeros((rows, columns), np.int32)
    wide = np.pad(disparity, radius, constant_values=np.nan)
    for dy, dx in _offsets(radius):
        there = wide[radius + dy : radius + dy + rows, radius + dx : radius + dx + columns]
        reach = np.float64(tolerance + gradient * max(abs(dy), abs(dx)))
        with np.errstate(invalid="ignore"):
            found += np.abs(there - disparity) <= reach
    return found


def nearest_difference(disparity: NDArray[np.float32], radius: int, nearest: int) -> NDArray[np.float32]:
    """Return the mean difference (H, W), px, from the most similar neighbours; see `kernels.nearest_difference`."""
    rows, columns = disparity.shape
    wide = np.pad(disparity, radius, constant_values=np.nan)
    offsets = list(_offsets(radius))
    result = np.full((rows, columns), np.nan, np.float32)
    if nearest > len(offsets):
        return result
    strip = max(1, STRIP_BYTES // (4 * columns * len(offsets)))
    for first in range(0, rows, strip):
        here = disparity[first : first + strip]
        size = here.shape[0]
        differences = np.empty((len(offsets), size, columns), np.float32)
        for k, (dy, dx) in enumerate(offsets):
            top, left = first + radius + dy, radius + dx
            np.abs(wide[top : top + size, left : left + columns] - here, out=differences[k])
        best = np.sort(np.partition(differences, nearest - 1, axis=0)[:nearest], axis=0)  # NaN comes last
        total = np.zeros(here.shape, np.float32)
        for layer in best:
            total += layer
        result[first : first + size] = total / np.float32(nearest)
    return result


def _offsets(radius: int) -> Iterator[tuple[int, int]]:
    """Yield rows and columns from a pixel to its neighbours."""
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            if dy or dx:
                yield dy, dx
