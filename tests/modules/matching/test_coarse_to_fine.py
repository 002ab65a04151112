"""Matching tile by tile: what must not change, and what is found."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from modules.matching.aggregation import Storage, aggregate
from modules.matching.coarse_to_fine import TILE_PX, Tile, match_tiles, part_of, plan_tiles
from modules.matching.semi_global_match import SemiGlobalMatchParams, match_gray, semi_global_match, state_problem
from modules.types import DisparityRange, Matching, Views


def pair(rows: int = 40, columns: int = 90, disparity: int = 6) -> tuple[np.ndarray, np.ndarray]:
    wide = np.random.default_rng(2).integers(0, 256, (rows, columns + 80)).astype(np.uint8)
    wide = np.asarray(cv2.GaussianBlur(wide, (0, 0), 1.0), np.uint8)
    left, right = wide[:, 40 : 40 + columns], wide[:, 40 + disparity : 40 + disparity + columns]
    return np.ascontiguousarray(left), np.ascontiguousarray(right)


@pytest.mark.parametrize(("low", "high"), [(0, 20), (3, 50), (-30, 12)])
@pytest.mark.parametrize(("part_low", "part_high", "strips"), [(3, 12, 1), (5, 9, 3)])
def test_one_tile_that_sees_everything_gives_what_its_range_gives(
    low: int, high: int, part_low: int, part_high: int, strips: int
) -> None:
    left, right = pair()
    params = SemiGlobalMatchParams(subpixel="equiangular")
    everywhere = (slice(0, 40), slice(0, 90))
    narrow = DisparityRange(part_low, part_high)
    whole = state_problem(left, right, DisparityRange(low, high), params)
    found = match_tiles(whole, [Tile(everywhere, everywhere, narrow)], [Storage(strips)], None)
    expected = aggregate(state_problem(left, right, narrow, params), Storage(), None)
    np.testing.assert_allclose(found.disparity, expected.disparity, atol=1e-5)
    np.testing.assert_array_equal(found.ratio, expected.ratio)
    np.testing.assert_allclose(found.right_px, expected.right_px, atol=1e-5)
    np.testing.assert_array_equal(found.right_cost, expected.right_cost)


def test_tiles_decide_every_pixel_once_and_see_beyond() -> None:
    tiles = plan_tiles(np.full((400, 550), 8.0, np.float32), (800, 1100), DisparityRange(0, 64))
    decided = np.zeros((800, 1100), int)
    for tile in tiles:
        decided[tile.core] += 1
        assert tile.seen[0].start <= tile.core[0].start
        assert tile.seen[1].stop >= tile.core[1].stop
        assert tile.core[1].stop - tile.core[1].start <= 1.5 * TILE_PX
    assert (decided == 1).all()


def test_a_tile_gets_the_range_of_its_coarse_disparities_or_all() -> None:
    coarse = np.full((256, 512), np.nan, np.float32)
    coarse[:, :200] = np.linspace(20, 30, 200)
    search = DisparityRange(0, 200)
    first, *_, last = plan_tiles(coarse, (512, 1024), search)
    assert first.search.min_px in range(10, 16)
    assert first.search.max_px in range(34, 42)
    assert last.search == search


def test_a_range_of_a_tile_stays_within_what_is_searched() -> None:
    coarse = np.full((50, 50), 3.0, np.float32)
    (tile,) = plan_tiles(coarse, (100, 100), DisparityRange(0, 5))
    assert tile.search == DisparityRange(0, 5)
    (tile,) = plan_tiles(coarse, (100, 100), DisparityRange(40, 60))
    assert tile.search == DisparityRange(40, 41)


def test_a_slanted_ground_is_found_as_by_matching_at_once_whatever_the_threads() -> None:
    rows, columns = 420, 700
    right = np.random.default_rng(3).integers(0, 256, (rows, columns + 160)).astype(np.uint8)
    right = np.asarray(cv2.GaussianBlur(right, (0, 0), 1.2) * 3.0 - 255.0).clip(0, 255).astype(np.uint8)
    down, across = np.mgrid[0:rows, 0:columns].astype(np.float32)
    truth = 10 + 0.2 * down
    left = cv2.remap(right, across + 130 - truth, down, cv2.INTER_CUBIC)
    views = Views(np.asarray(left, np.uint8), np.ascontiguousarray(right[:, 130 : 130 + columns]))
    search = DisparityRange(0, 128)
    once, tiled = (
        semi_global_match(Matching(views, search), SemiGlobalMatchParams(coarse_to_fine=coarse)).disparity
        for coarse in (False, True)
    )
    assert once is not None
    assert tiled is not None
    inside = (slice(None), slice(120, -8))
    wrong = [np.mean(~(np.abs(found.disparity_px - truth)[inside] < 1)) for found in (once, tiled)]
    assert wrong[1] <= wrong[0] + 0.002
    single = match_gray(views.left, views.right, search, SemiGlobalMatchParams(coarse_to_fine=True, threads=1))
    double = match_gray(views.left, views.right, search, SemiGlobalMatchParams(coarse_to_fine=True, threads=2))
    np.testing.assert_array_equal(single.disparity, double.disparity)
    np.testing.assert_array_equal(single.right_px, double.right_px)


def test_a_tile_is_guided_by_its_own_part_of_the_image() -> None:
    left, right = pair(rows=300, columns=600)
    guide = np.random.default_rng(4).integers(0, 256, (300, 600, 3)).astype(np.uint8)
    problem = state_problem(left, right, DisparityRange(-8, 24), SemiGlobalMatchParams(smooth_px=0.0), guide=guide)
    tiles = plan_tiles(np.full((150, 300), 6.0, np.float32), left.shape, DisparityRange(-8, 24))
    rows, columns = tiles[-1].seen
    np.testing.assert_array_equal(part_of(problem, tiles[-1]).guide, np.moveaxis(guide[rows, columns], 2, 0))


def test_tiles_in_a_pool_are_those_in_turn() -> None:
    left, right = pair(rows=300, columns=600)
    params = SemiGlobalMatchParams(subpixel="parabola")
    problem = state_problem(left, right, DisparityRange(-8, 24), params)
    tiles = plan_tiles(np.full((150, 300), 6.0, np.float32), left.shape, DisparityRange(-8, 24))
    with ThreadPoolExecutor(2) as pool:
        one, two = (
            match_tiles(problem, tiles, [Storage(costs=True)] * len(tiles), None),
            match_tiles(problem, tiles, [Storage(2)] * len(tiles), pool),
        )
    np.testing.assert_array_equal(one.disparity, two.disparity)
    np.testing.assert_array_equal(one.right_cost, two.right_cost)
    assert np.mean(np.abs(one.right_px[:, 5:-8] - 6) < 0.5) > 0.97
