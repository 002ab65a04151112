"""Match coarsely first, then tile by tile in the range that each tile needs.

For large images with a large range, of which each part of the scene uses little: time and memory follow the ranges of
the tiles. What the half-size images do not show, such as a post one pixel wide before a far background, may be lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np

from modules.matching.aggregation import Problem, Selection, Storage, aggregate
from modules.matching.common import Bytes, at_match, do_all
from modules.types import DisparityRange, FloatImage

TILE_PX = 256  # side of what a tile decides
OVERLAP_PX = 32  # matched beyond it on every side, so that paths have settled
AGREEMENT_PX = 1.0  # a coarse disparity counts if the right image confirms it this well, coarse px
FEWEST_SHARE = 0.1  # of a tile's coarse pixels that must be confirmed; else it gets the whole range
STRAY_SHARE = 0.002  # of them that may lie outside at either end
MARGIN_PX, MARGIN_SHARE = 6, 0.1  # added to the coarse range at either end: px, and share of its width

Match = Callable[[Bytes, Bytes, DisparityRange], Selection]


@dataclass(frozen=True)
class Tile:
    """A part of the left image: rows and columns that it decides and that it matches, and the range for it."""

    core: tuple[slice, slice]
    seen: tuple[slice, slice]
    search: DisparityRange

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns that it matches."""
        rows, columns = self.seen
        return rows.stop - rows.start, columns.stop - columns.start


def confirmed_coarse(left: Bytes, right: Bytes, search: DisparityRange, match: Match) -> FloatImage:
    """Return disparities of the half-size images (h, w) in px of the full ones, NaN where the right one disagrees."""
    shape = (-(-left.shape[1] // 2), -(-left.shape[0] // 2))
    small = [np.asarray(cv2.resize(image, shape, interpolation=cv2.INTER_AREA), np.uint8) for image in (left, right)]
    half = DisparityRange(search.min_px // 2, max(-(-search.max_px // 2), search.min_px // 2) + 1)
    found = match(small[0], small[1], half)
    back, known = at_match(found.right_px, found.disparity)
    with np.errstate(invalid="ignore"):
        agrees = known & (np.abs(back - found.disparity) <= AGREEMENT_PX) & np.isfinite(found.ratio)
    return np.where(agrees, 2.0 * found.disparity, np.nan).astype(np.float32)


def plan_tiles(coarse: FloatImage, shape: tuple[int, int], search: DisparityRange) -> list[Tile]:
    """Cut an image into tiles and give each the range that its coarse disparities (h, w) ask for."""
    tiles = []
    for rows, seen_rows in _cuts(shape[0]):
        for columns, seen_columns in _cuts(shape[1]):
            part = coarse[
                seen_rows.start // 2 : -(-seen_rows.stop // 2), seen_columns.start // 2 : -(-seen_columns.stop // 2)
            ]
            tiles.append(Tile((rows, columns), (seen_rows, seen_columns), _range_of(part, search)))
    return tiles


def _cuts(length: int) -> Iterator[tuple[slice, slice]]:
    """Yield what each tile decides and what it sees along one axis."""
    number = max(round(length / TILE_PX), 1)
    edges = [length * k // number for k in range(number + 1)]
    for begin, end in pairwise(edges):
        yield slice(begin, end), slice(max(begin - OVERLAP_PX, 0), min(end + OVERLAP_PX, length))


def _range_of(coarse: FloatImage, search: DisparityRange) -> DisparityRange:
    """Return the range that coarse disparities ask for, within the one that is searched."""
    confirmed = coarse[np.isfinite(coarse)]
    if confirmed.size < FEWEST_SHARE * coarse.size:
        return search
    low, high = np.quantile(confirmed, (STRAY_SHARE, 1.0 - STRAY_SHARE))
    margin = MARGIN_PX + MARGIN_SHARE * (high - low)
    least = min(max(int(np.floor(low - margin)), search.min_px), search.max_px - 1)
    return DisparityRange(least, max(min(int(np.ceil(high + margin)) + 1, search.max_px), least + 1))


def match_tiles(
    problem: Problem, tiles: list[Tile], storages: list[Storage], pool: ThreadPoolExecutor | None
) -> Selection:
    """Match every tile in its range.

    Parameters
    ----------
    problem : Problem
        Of the whole images and range.
    tiles : list of Tile
    storages : list of Storage
        Of each tile; see `aggregation.plan_storage`.
    pool : ThreadPoolExecutor or None
        Matches tiles at once; the result does not depend on it.

    Returns
    -------
    Selection
        A right pixel that several tiles reach takes the disparity of least cost.
    """
    shape = problem.shape
    disparity, ratio, right_px = (np.full(shape, np.nan, np.float32) for _ in range(3))
    out = Selection(disparity, ratio, right_px, np.full(shape, np.inf, np.float32))

    def solve(case: tuple[Tile, Storage]) -> Selection:
        tile, storage = case
        return aggregate(part_of(problem, tile), storage, None)

    found = do_all(pool, solve, zip(tiles, storages, strict=True))
    for tile, part in zip(tiles, found, strict=True):
        _paste(tile, part, out)
    return out


def part_of(problem: Problem, tile: Tile) -> Problem:
    """Return the problem of one tile; its disparities count from the least of the tile, and so do its right columns."""
    rows, columns = tile.seen
    width = columns.stop - columns.start
    first = problem.before - (columns.stop - 1) + tile.search.min_px - problem.low
    part = replace(problem, low=0, searched=tile.search.count, before=width - 1)
    length = width - 1 + -(-part.count // 32) * 32
    right = problem.right[:, rows, first : first + length]
    missing = length - right.shape[2]  # beyond all that is searched
    return replace(
        part,
        left=np.ascontiguousarray(problem.left[rows, columns]),
        right=np.ascontiguousarray(np.pad(right, ((0, 0), (0, 0), (0, missing)), mode="edge") if missing else right),
        guide=np.ascontiguousarray(problem.guide[:, rows, columns]),
        right_begin=1 - part.searched,
        right_columns=width + part.searched - 1,
    )


def _paste(tile: Tile, part: Selection, out: Selection) -> None:
    """Put what a tile decides into the whole."""
    inner_rows, inner_columns = (
        slice(core.start - seen.start, core.stop - seen.start) for core, seen in zip(tile.core, tile.seen, strict=True)
    )
    inner = inner_rows, inner_columns
    low = np.float32(tile.search.min_px)
    out.disparity[tile.core] = part.disparity[inner] + low
    out.ratio[tile.core] = part.ratio[inner]
    begin = tile.seen[1].start - tile.search.max_px + 1  # right column of the first that the part reports
    first, last = max(begin, 0), min(begin + part.right_px.shape[1], out.right_px.shape[1])
    if first >= last:
        return
    there = (tile.core[0], slice(first, last))
    here = (inner_rows, slice(first - begin, last - begin))
    better = part.right_cost[here] < out.right_cost[there]
    out.right_px[there] = np.where(better, part.right_px[here] + low, out.right_px[there])
    out.right_cost[there] = np.where(better, part.right_cost[here], out.right_cost[there])
