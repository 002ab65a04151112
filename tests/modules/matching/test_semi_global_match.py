"""The semi-global matcher against a plain reference, and its bounds on memory."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from modules.matching.check_left_right import CheckLeftRightParams, check_left_right
from modules.matching.kernels import cost as cost_kernels
from modules.matching.kernels import paths as path_kernels
from modules.matching.semi_global_match import (
    OVERLAP_ROWS,
    SemiGlobalMatchParams,
    rows_per_strip,
    semi_global_match,
)
from modules.operator import OperatorError
from modules.types import DisparityRange, Matching, Views


def plain_path(
    cost: NDArray[np.int64], gray: NDArray[np.int32], p1: int, p2: NDArray[np.int64], dy: int, dx: int
) -> NDArray[np.int64]:
    """Return the path cost of one direction, written as in the paper."""
    rows, columns, count = cost.shape
    out = np.zeros_like(cost)
    ys = range(rows) if dy >= 0 else range(rows - 1, -1, -1)
    xs = range(columns) if dx >= 0 else range(columns - 1, -1, -1)
    for y in ys:
        for x in xs:
            py, px = y - dy, x - dx
            if not (0 <= py < rows and 0 <= px < columns):
                out[y, x] = cost[y, x]
                continue
            old = out[py, px]
            jump = old.min() + p2[abs(int(gray[y, x]) - int(gray[py, px]))]
            for d in range(count):
                near = [old[k] + p1 for k in (d - 1, d + 1) if 0 <= k < count]
                out[y, x, d] = cost[y, x, d] + min([old[d], jump, *near]) - old.min()
    return out


@pytest.mark.parametrize("backward", [False, True])
def test_aggregation_equals_a_plain_implementation(backward: bool) -> None:
    rng = np.random.default_rng(4)
    searched = 7
    cost = np.full((9, 11, 16), cost_kernels.PADDING, np.uint8)
    cost[:, :, :searched] = rng.integers(0, 247, (9, 11, searched))
    gray = rng.integers(0, 256, (9, 11)).astype(np.int32)
    p2 = np.maximum(250 / (1 + 0.05 * np.arange(256)), 38).astype(np.int16)
    found = np.zeros(cost.shape, np.int16)
    paths, least = np.empty((2, 3, 13, 18), np.int16), np.empty((2, 3, 13), np.int16)
    path_kernels.start_paths(paths, least)
    for begin, end in ((0, 4), (4, 9)):
        path_kernels.aggregate(cost, searched, gray, 38, p2, backward, begin, end, paths, least, found)
    directions = [(0, 1), (1, 1), (1, 0), (1, -1)]
    sign = -1 if backward else 1
    truth = sum(
        plain_path(cost[:, :, :searched].astype(np.int64), gray, 38, p2.astype(np.int64), sign * dy, sign * dx)
        for dy, dx in directions
    )
    # Beyond the border the reference starts a path afresh; the kernel starts from zero cost, which is the same.
    np.testing.assert_array_equal(found[:, :, :searched], truth)


def test_the_cost_equals_a_plain_implementation() -> None:
    rng = np.random.default_rng(5)
    left, right = rng.integers(0, 2**24, (2, 8, 12)).astype(np.uint32)
    slopes = rng.integers(-1020, 1021, (2, 8, 12)).astype(np.int16)
    low, count = -3, 9
    found = np.zeros((8, 12, count), np.uint8)
    cost_kernels.cost_rows(left, right, slopes[0], slopes[1], low, 31, 1, 0, 8, found)
    raw = np.zeros((8, 12, count))
    for y in range(8):
        for x in range(12):
            for d in range(count):
                xr = min(max(x - low - d, 0), 11)
                bits = int(left[y, x] ^ right[y, xr]).bit_count()
                raw[y, x, d] = bits + 0.5 * min(abs(int(slopes[0, y, x]) - int(slopes[1, y, xr])), 31)
    wide = np.pad(raw, ((1, 1), (1, 1), (0, 0)), mode="edge")
    mean = sum(wide[dy : dy + 8, dx : dx + 12] for dy in range(3) for dx in range(3)) / 9
    np.testing.assert_allclose(found, np.floor(mean * cost_kernels.COST_UNITS), atol=1)


def test_a_part_of_the_rows_costs_the_same_as_all_of_them() -> None:
    rng = np.random.default_rng(6)
    left, right = rng.integers(0, 2**24, (2, 20, 12)).astype(np.uint32)
    slopes = rng.integers(-1020, 1021, (2, 20, 12)).astype(np.int16)
    whole, part = np.zeros((20, 12, 8), np.uint8), np.zeros((7, 12, 8), np.uint8)
    cost_kernels.cost_rows(left, right, slopes[0], slopes[1], 0, 31, 2, 0, 20, whole)
    cost_kernels.cost_rows(left, right, slopes[0], slopes[1], 0, 31, 2, 6, 13, part)
    np.testing.assert_array_equal(part, whole[6:13])


def random_pair(rows: int = 80, columns: int = 120, disparity: int = 5) -> Views:
    wide = np.random.default_rng(7).integers(0, 256, (rows, columns + 20)).astype(np.uint8)
    return Views(wide[:, :columns].copy(), wide[:, disparity : disparity + columns].copy())


def test_every_increasing_map_leaves_the_census_result_unchanged() -> None:
    views = random_pair()
    half = Views((views.left // 2).astype(np.uint8), (views.right // 2).astype(np.uint8))
    curved = Views(half.left, np.rint(255 * (half.right / 127.0) ** 0.5).astype(np.uint8))
    params = SemiGlobalMatchParams(cost="census", subpixel="equiangular")
    one, two = (semi_global_match(Matching(v, DisparityRange(0, 12)), params).disparity for v in (half, curved))
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.disparity_px, two.disparity_px)


def test_confidence_is_a_probability_and_right_and_left_agree() -> None:
    state = semi_global_match(Matching(random_pair(), DisparityRange(0, 12)), SemiGlobalMatchParams())
    assert state.disparity is not None
    confidence = state.disparity.confidence
    assert confidence is not None
    assert confidence.min() >= 0
    assert confidence.max() <= 1
    assert confidence[state.disparity.valid].mean() > 0.9
    checked = check_left_right(state, CheckLeftRightParams()).disparity
    assert checked is not None
    assert checked.valid.mean() > 0.9


def test_strips_are_as_good_as_the_whole() -> None:
    views = random_pair(rows=240, columns=600)
    whole, strips = (
        semi_global_match(Matching(views, DisparityRange(0, 100)), SemiGlobalMatchParams(max_memory_mb=mb)).disparity
        for mb in (512, 20)
    )
    assert rows_per_strip(240, 600, 100, 20) < 240
    assert whole is not None
    assert strips is not None
    same = np.isclose(whole.disparity_px, strips.disparity_px, atol=0.25, equal_nan=True)
    assert same.mean() > 0.98


def test_strips_cover_the_image_within_the_memory_and_too_little_memory_is_refused() -> None:
    height = rows_per_strip(1000, 1000, 128, 100)
    assert (height + 2 * OVERLAP_ROWS) * 1000 * 128 * 3 <= 100e6
    with pytest.raises(OperatorError, match="need at least 25 MB, but max_memory_mb is 24"):
        rows_per_strip(1000, 1000, 128, 24)
