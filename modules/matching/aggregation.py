"""Semi-global aggregation in bounded memory, by one or two threads, with one result.

Two sweeps, downwards and upwards, carry four paths each. Both start at once and keep the sums of their half of the
rows; where they meet, each goes on through the half of the other, whose sums are there, and every row is finished:
added up and decided. Two bytes per pixel and disparity are kept, the sum and the cost; where that is too much, the cost
is computed once more. Where even one byte is too much, the halves are cut into strips: of all but the last only the
state of the sweep before it is kept, and when the other sweep arrives the strip is swept once more from that state.
Nothing is approximated: the result depends neither on the number of threads nor on the memory.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from modules.matching.common import Bytes, do_all
from modules.matching.features import in_vectors
from modules.operator import OperatorError
from modules.types import FloatImage

COST_ROWS = 32  # rows whose cost is computed at a time
FINAL_ROWS = 4  # rows that are decided at a time, while they are in the cache
LARGEST_SHIFT_PX = 2  # of a window
STATES = 6  # rows of path costs in one state: three paths, the row before and this one


@dataclass(frozen=True)
class Problem:
    """What is matched; the arrays are as `kernels.cost.cost_rows` and `kernels.sweeps.sweep_rows` want them.

    Attributes
    ----------
    left : uint8 (H, W, K + 1)
    right : uint8 (K + 1, H, L)
    before : int
    low, searched : int
        First disparity and their number, px.
    bit_shift, value_limit, radius : int
    levels : float
    most : int
    guide : uint8 (C, H, W)
        Planes of the left image whose largest step along a path selects the penalties.
    p1_of_step, p2_of_step : uint8 (256,)
    diagonals : bool
    curve : int
    shift : int
        How far a window may be shifted to where it costs least, px.
    right_begin : int
    right_columns : int or None
        First column of the right image that is decided, and their number; None for as many as the left one has.
    """

    left: Bytes
    right: Bytes
    before: int
    low: int
    searched: int
    bit_shift: int
    value_limit: int
    radius: int
    levels: float
    most: int
    guide: Bytes
    p1_of_step: Bytes
    p2_of_step: Bytes
    diagonals: bool
    curve: int
    shift: int = 0
    right_begin: int = 0
    right_columns: int | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.left.shape[0], self.left.shape[1]

    @property
    def count(self) -> int:
        """Disparities held, in whole vectors."""
        return in_vectors(self.searched)


def steps_along(guide: Bytes, backward: bool) -> Bytes:
    """Return the largest step of the planes of a guide (C, H, W) from the pixel before along the paths of a sweep.

    Returns
    -------
    uint8 (4, H, W)
        In the row, from the corner behind, from the row before, from the corner ahead; beyond the border as from the
        nearest pixel, where no path comes from.
    """
    sign = -1 if backward else 1
    before = [(0, -sign), (-sign, -sign), (-sign, 0), (-sign, sign)]  # rows and columns to where a path comes from
    rows, columns = guide.shape[1:]
    found = np.zeros((4, rows, columns), np.uint8)
    for plane in guide:
        wide = cv2.copyMakeBorder(plane, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
        for step, (dy, dx) in zip(found, before, strict=True):
            there = wide[1 + dy : 1 + dy + rows, 1 + dx : 1 + dx + columns]
            np.maximum(step, cv2.absdiff(plane, there), out=step)
    return found


@dataclass(frozen=True)
class Selection:
    """What is decided.

    Attributes
    ----------
    disparity, ratio : float32 (H, W)
        Disparity of the left image, px; second best cost over the best, NaN where the cost is flat.
    right_px, right_cost : float32 (H, R)
        Disparity of the right image, NaN where no left pixel reaches, and its cost.
    """

    disparity: FloatImage
    ratio: FloatImage
    right_px: FloatImage
    right_cost: FloatImage


@dataclass(frozen=True)
class State:
    """How far a sweep has come: path costs and their least in the row before and this one; room for a path along it."""

    paths: Bytes
    least: Bytes
    along: Bytes

    def row(self, index: int) -> tuple[Bytes, Bytes]:
        """Return the path costs and their least in the row before a row, counted from where the sweep starts."""
        return self.paths[index % 2], self.least[index % 2]


@dataclass(frozen=True)
class Storage:
    """What is kept of a half of the rows until the other sweep arrives; the result does not depend on it.

    Attributes
    ----------
    strips : int
        Into how many the half is cut.
    costs : bool
        Whether the matching costs are kept, which otherwise are computed once more; only of a half that is not cut.
    """

    strips: int = 1
    costs: bool = False


def plan_storage(shape: tuple[int, ...], count: int, max_memory_mb: int, name: str, shift_px: int = 0) -> Storage:
    """Return the fastest storage for an image (H, W) that fits.

    Raises
    ------
    OperatorError
        If the memory does not suffice, however many strips there are.
    """
    rows, columns = shape
    half = math.ceil(rows / 2)
    held = in_vectors(count)
    ways = [Storage(costs=True), *(Storage(strips) for strips in range(1, half + 1))]
    sizes = [_bytes_needed(half, columns, held, way, shift_px) for way in ways]
    for size, way in zip(sizes, ways, strict=True):
        if size <= max_memory_mb * 1e6:
            return way
    raise OperatorError(
        f"{name}: {columns}x{rows} px and {count} disparities need at least {math.ceil(min(sizes) / 1e6)} MB, "
        f"but max_memory_mb is {max_memory_mb}; raise it, narrow the range or reduce the images"
    )


def _bytes_needed(half: int, columns: int, count: int, storage: Storage, shift_px: int) -> int:
    """Return the memory of both threads."""
    saved = 3 * storage.strips if storage.strips > 1 else 0
    replay = STATES if storage.strips > 1 else 0
    cost = half if storage.costs else COST_ROWS
    shifted = COST_ROWS + 2 * shift_px if shift_px else 0
    rows = math.ceil(half / storage.strips) + saved + STATES + replay + cost + shifted + 2 * FINAL_ROWS
    return 2 * rows * (columns + 2) * (count + 2)


class _Worker:
    """One of the two sweeps, and the rows in which it decides."""

    def __init__(self, problem: Problem, backward: bool, storage: Storage, out: Selection) -> None:
        self.problem, self.backward, self.storage, self.out = problem, backward, storage, out
        rows, columns = problem.shape
        middle = rows // 2
        low, high = (middle, rows) if backward else (0, middle)
        edges = [low + (high - low) * k // storage.strips for k in range(storage.strips + 1)]
        own = list(pairwise(edges))
        self.strips = own[::-1] if backward else own  # in the order of the sweep
        size = columns * problem.count
        tallest = max(bottom - top for top, bottom in own)
        self.kept = np.empty((max(tallest, 1), size), np.uint8)
        self.saved: list[tuple[Bytes, Bytes]] = []
        self.state = self._fresh()
        self.cost = np.empty((max(tallest, 1) if storage.costs else COST_ROWS, size), np.uint8)
        self.total = np.empty((FINAL_ROWS, size), np.uint16)
        self.steps = steps_along(problem.guide, backward)

    def _fresh(self) -> State:
        columns, cell = self.problem.shape[1], self.problem.count + 2
        paths = np.zeros((2, columns + 2, 3, cell), np.uint8)
        paths[..., 0] = paths[..., -1] = 255
        return State(paths.reshape(2, -1), np.zeros((2, columns + 2, 3), np.uint8), np.full(2 * cell, 255, np.uint8))

    def keep_own_half(self) -> None:
        """Sweep over the half where the sweep starts: keep the sums of the last strip, and the state before it."""
        from modules.matching.kernels import sweeps

        for number, (top, bottom) in enumerate(self.strips):
            last = number == len(self.strips) - 1
            if not last:
                paths, least = self.state.row(self._index(top, bottom)[0])
                self.saved.append((paths.copy(), least.copy()))
            self.sweep(self.state, top, bottom, sweeps.KEEP if last else sweeps.CARRY, self.kept, self.cost)

    def finish_half_of(self, other: _Worker) -> None:
        """Sweep on over the half of the other, whose sums are there or are made again, and decide its rows."""
        from modules.matching.kernels import sweeps

        again = self._fresh() if other.saved else None
        for number in range(len(other.strips) - 1, -1, -1):
            top, bottom = other.strips[number]
            if again is not None and number < len(other.saved):
                for held, saved in zip(again.row(other._index(top, bottom)[0]), other.saved[number], strict=True):
                    held[:] = saved
                other.sweep(again, top, bottom, sweeps.KEEP, other.kept, self.cost)
            cost = other.cost if self.storage.costs else self.cost
            self.sweep(self.state, top, bottom, sweeps.JOIN, other.kept, cost)

    def _index(self, top: int, bottom: int) -> tuple[int, int]:
        """Return rows of the image as rows counted from where the sweep starts."""
        rows = self.problem.shape[0]
        return (rows - bottom, rows - top) if self.backward else (top, bottom)

    def sweep(self, state: State, top: int, bottom: int, mode: int, kept: Bytes, cost: Bytes) -> None:
        """Sweep over rows top to bottom of the image; `cost` is room for their costs, or holds them from before."""
        from modules.matching.kernels import sweeps

        final = mode == sweeps.JOIN
        for first, last in self._batches(top, bottom, COST_ROWS):
            cost_top = top if self.storage.costs else first
            if not (self.storage.costs and final):
                self._fill_cost(first, last, cost[first - cost_top :])
            for begin, end in self._batches(first, last, FINAL_ROWS) if final else [(first, last)]:
                p = self.problem
                sweeps.sweep_rows(
                    cost,
                    cost_top,
                    self.steps,
                    *self._index(begin, end),
                    self.backward,
                    p.diagonals,
                    p.p1_of_step,
                    p.p2_of_step,
                    state.paths,
                    state.least,
                    state.along,
                    mode,
                    kept,
                    top,
                    self.total,
                )
                if final:
                    self._decide(begin, end)

    def _batches(self, top: int, bottom: int, size: int) -> list[tuple[int, int]]:
        """Cut rows into batches, in the order of the sweep."""
        cuts = [(first, min(first + size, bottom)) for first in range(top, bottom, size)]
        return cuts[::-1] if self.backward else cuts

    def _fill_cost(self, first: int, last: int, cost: Bytes) -> None:
        from modules.matching.kernels import cost as kernels

        p = self.problem
        top, bottom = max(first - p.shift, 0), min(last + p.shift, p.shape[0])
        windows = np.empty((bottom - top, cost.shape[1]), np.uint8) if p.shift else cost[: last - first]
        kernels.cost_rows(
            p.left,
            p.right,
            p.before,
            p.searched,
            p.bit_shift,
            p.value_limit,
            p.radius,
            p.levels,
            p.most,
            top,
            bottom,
            windows,
        )
        if p.shift:
            kernels.shift_windows(windows, first - top, last - top, p.shift, p.shape[1], cost[: last - first])

    def _decide(self, begin: int, end: int) -> None:
        from modules.matching.kernels import selection

        p, out, part = self.problem, self.out, slice(begin, end)
        total = self.total[: end - begin]
        selection.select_rows(
            total,
            p.searched,
            p.low,
            p.curve,
            out.disparity[part],
            out.ratio[part],
            p.right_begin,
            out.right_px[part],
            out.right_cost[part],
        )


def aggregate(problem: Problem, storage: Storage, pool: ThreadPoolExecutor | None) -> Selection:
    """Return what has the least sum of path costs.

    Parameters
    ----------
    problem : Problem
    storage : Storage
        See `plan_storage`.
    pool : ThreadPoolExecutor or None
        Where the sweeps run, at least two threads; None for the calling thread.
    """
    rows, columns = problem.shape
    reached = columns if problem.right_columns is None else problem.right_columns
    out = Selection(*(np.empty((rows, width), np.float32) for width in (columns, columns, reached, reached)))
    down, up = (_Worker(problem, backward, storage, out) for backward in (False, True))
    do_all(pool, _Worker.keep_own_half, (down, up))
    other = {down: up, up: down}
    do_all(pool, lambda worker: worker.finish_half_of(other[worker]), (down, up))
    return out
