"""Dynamic histogram warping: the increasing map between two histograms that costs least."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modules.primitives.statistics import Floats

Planes = NDArray[np.float32]

FAR = np.float32(1e9)  # cost beyond the border, larger than any path


@dataclass(frozen=True)
class LevelWarp:
    """Result of `warp_levels`.

    Attributes
    ----------
    tables : float64 (C, N)
        Level of the target for each level of the source; never decreasing.
    costs : float64 (C,)
        Sum of absolute differences of normalised counts along the path, 0 for equal histograms, at most 2: how far one
        increasing map is from explaining the difference.
    """

    tables: Floats
    costs: Floats


def warp_levels(source: Floats, target: Floats, max_run: int) -> LevelWarp:
    """Warp histograms onto others by dynamic programming.

    Parameters
    ----------
    source, target : float64 (C, N)
        Histograms over N levels, one pair per channel; counts are normalised here.
    max_run : int
        Most levels of one histogram that one level of the other may take.

    Notes
    -----
    `D(m, n)` is the least of `D(m-1, n-1) + |A_m - B_n|`, of `D(m-k, n-1)` plus the difference of the k levels of A to
    B_n, and of `D(m-1, n-l)` plus that of A_m to the l levels of B, for k and l from 2 to `max_run`. Every predecessor
    lies in an earlier row, so a whole row is evaluated at once, for all channels. The path is followed back by the
    predecessor that gave each cost, found again from the same sums; a walk to the cheapest neighbour would be another
    path. Ties go to the diagonal, then to the shortest run of the source.

    References
    ----------
    I. J. Cox, S. Roy, S. L. Hingorani, Dynamic histogram warping of image pairs for constant image brightness, ICIP
    1995.
    """
    steps = _Steps(_normalised(source), _normalised(target), max_run)
    table = _fill(steps)
    tables = np.stack([_follow(steps, table, channel) for channel in range(len(source))])
    return LevelWarp(tables, table[-1, :, -1].astype(np.float64))


def _normalised(counts: Floats) -> Floats:
    return counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)


class _Steps:
    """The costs of the steps into a row: differences of one level and of runs of levels, float32."""

    def __init__(self, a: Floats, b: Floats, max_run: int) -> None:
        self.channels, self.count = a.shape
        self.max_run = max_run
        self.runs = np.arange(2, max_run + 1)
        self.source, self.target = a.astype(np.float32), b.astype(np.float32)
        self.weights = b
        ends = np.arange(1, self.count + 1)
        self.source_runs, self.target_runs = (self._sums_of_runs(x, ends) for x in (a, b))

    def _sums_of_runs(self, counts: Floats, ends: NDArray[np.int64]) -> Planes:
        """Return, per run length and channel, the sum of the run that ends at each level, (M - 1, C, N)."""
        sums = np.concatenate([np.zeros((self.channels, 1)), np.cumsum(counts, axis=1)], axis=1)
        starts = np.maximum(ends[None, :] - self.runs[:, None], 0)
        return np.ascontiguousarray((sums[:, None, ends] - sums[:, starts]).transpose(1, 0, 2).astype(np.float32))

    def into(self, m: int, out: Planes) -> None:
        """Write the costs of all steps into row `m` (from 1) to `out` (2 M - 1, C, N): diagonal, k, l."""
        value = self.source[None, :, m - 1, None]
        np.subtract(value[0], self.target, out=out[0])
        np.subtract(self.source_runs[:, :, m - 1, None], self.target, out=out[1 : self.max_run])
        np.subtract(value, self.target_runs, out=out[self.max_run :])
        np.abs(out, out=out)


def _fill(steps: _Steps) -> Planes:
    """Return the costs D, (N + 1 + M, C, N + 1 + M): M rows and columns of infinite cost stand before the first."""
    pad, count = steps.max_run, steps.count
    table = np.full((count + 1 + pad, steps.channels, count + 1 + pad), FAR, np.float32)
    table[pad, :, pad] = 0
    shifted = np.lib.stride_tricks.sliding_window_view(table, count, axis=2)
    costs = np.empty((2 * pad - 1, steps.channels, count), np.float32)
    for m in range(1, count + 1):
        row = m + pad
        steps.into(m, costs)
        costs[0] += table[row - 1, :, pad : pad + count]
        costs[1:pad] += table[row - 2 : row - pad - 1 : -1, :, pad : pad + count]
        costs[pad:] += shifted[row - 1, :, pad - 1 : 0 : -1].transpose(1, 0, 2)
        np.min(costs, axis=0, out=table[row, :, pad + 1 :])
    return table


def _follow(steps: _Steps, table: Planes, channel: int) -> Floats:
    """Return the map of one channel, (N,), by following the costs back from the last cell."""
    pad, runs = steps.max_run, steps.runs
    mapped = np.zeros(steps.count)
    m = n = steps.count
    while m > 0:
        value, other = steps.source[channel, m - 1], steps.target[channel, n - 1]
        row, column = m + pad, n + pad
        costs = np.concatenate(
            [
                [abs(value - other) + table[row - 1, channel, column - 1]],
                np.abs(steps.source_runs[:, channel, m - 1] - other) + table[row - runs, channel, column - 1],
                np.abs(value - steps.target_runs[:, channel, n - 1]) + table[row - 1, channel, column - runs],
            ]
        )
        choice = int(np.argmin(costs))
        k, run = (choice + 1, 1) if choice < pad else (1, choice - pad + 2)
        levels = np.arange(n - run, n)
        weights = steps.weights[channel, levels]
        total = float(weights.sum())
        mapped[m - k : m] = float(levels @ weights) / total if total > 0 else float(levels.mean())
        m, n = m - k, n - run
    return mapped
