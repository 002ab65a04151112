"""The semi-global matcher against a plain reference; its threads, its memory and its costs."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from modules.matching.aggregation import Problem, Selection, Storage, aggregate, plan_storage, steps_along
from modules.matching.check_left_right import CheckLeftRightParams, check_left_right
from modules.matching.features import Features, census_bits, census_offsets, compute_features, slope_values
from modules.matching.kernels import cost as kernels
from modules.matching.semi_global_match import SemiGlobalMatchParams, match_gray, semi_global_match, state_problem
from modules.operator import OperatorError
from modules.types import DisparityRange, Matching, Views

Bytes = NDArray[np.uint8]


def plain_arrival(cost: NDArray[np.int64], problem: Problem, dy: int, dx: int) -> NDArray[np.int64]:
    """Return the least cost of arriving along one direction, above the least before, written as in the paper."""
    guide = problem.guide.astype(int)
    rows, columns, count = cost.shape
    arrival, path = np.zeros_like(cost), np.zeros_like(cost)
    for y in range(rows) if dy >= 0 else range(rows - 1, -1, -1):
        for x in range(columns) if dx >= 0 else range(columns - 1, -1, -1):
            py, px = y - dy, x - dx
            if 0 <= py < rows and 0 <= px < columns:
                old = path[py, px]
                step = np.abs(guide[:, y, x] - guide[:, py, px]).max()
                jump = old.min() + int(problem.p2_of_step[step])
                for d in range(count):
                    near = [old[k] + int(problem.p1_of_step[step]) for k in (d - 1, d + 1) if 0 <= k < count]
                    arrival[y, x, d] = min([old[d], jump, *near]) - old.min()
            path[y, x] = arrival[y, x] + cost[y, x]
    return arrival


def plain_total(cost: NDArray[np.int64], problem: Problem) -> NDArray[np.int64]:
    """Return the sum over all paths; each sweep's mean is rounded as bytes are."""

    def mean(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
        return (a + b + 1) // 2

    total = 2 * cost
    for sign in (1, -1):
        along, left, top, right = (
            plain_arrival(cost, problem, sign * dy, sign * dx) for dy, dx in ((0, 1), (1, 1), (1, 0), (1, -1))
        )
        both = mean(along, top)
        total = total + (mean(both, mean(left, right)) if problem.diagonals else both)
    return total


def plain_cost(problem: Problem) -> NDArray[np.int64]:
    """Return the cost of every pixel and disparity (H, W, D), from the compared bits and values."""
    rows, columns = problem.shape
    raw = np.zeros((rows, columns, problem.searched))
    for x in range(columns):
        for d in range(problem.searched):
            at = problem.before - x + d
            one, other = problem.left[:, x].astype(int), problem.right[:, :, at].T.astype(int)
            bits = np.bitwise_count(one[:, :-1] ^ other[:, :-1]).sum(axis=1)
            value = np.minimum(np.abs(one[:, -1] - other[:, -1]), problem.value_limit)
            raw[:, x, d] = (bits << problem.bit_shift) + value
    r, side = problem.radius, 2 * problem.radius + 1
    wide = np.pad(raw, ((r, r), (r, r), (0, 0)), mode="edge")
    mean = sum(wide[dy : dy + rows, dx : dx + columns] for dy in range(side) for dx in range(side)) / side**2
    return mean * problem.levels


def small_problem(
    seed: int, rows: int, columns: int, searched: int, low: int = 0, diagonals: bool = True, radius: int = 1
) -> Problem:
    rng = np.random.default_rng(seed)
    left, right = rng.integers(0, 256, (2, rows, columns)).astype(np.uint8)
    found = compute_features(left, right, low, searched, "hybrid", "5x5")
    guide = np.stack([left, rng.integers(0, 256, (rows, columns)).astype(np.uint8)])
    p1 = (24 / (1 + 0.02 * np.arange(256))).astype(np.uint8)
    p2 = np.maximum(150 / (1 + 0.05 * np.arange(256)), 20).astype(np.uint8)
    return Problem(
        found.left, found.right, found.before, low, searched, 1, 31, radius, 1.1, 90, guide, p1, p2, diagonals, 1
    )


def stored_cost(problem: Problem, start: int, stop: int) -> NDArray[np.uint8]:
    """Return the cost of some rows as it is stored (h, W, D), with what pads it to whole vectors."""
    p = problem
    columns = p.shape[1]
    out = np.zeros((stop - start, columns * p.count), np.uint8)
    kernels.cost_rows(
        p.left, p.right, p.before, p.searched, p.bit_shift, p.value_limit, p.radius, p.levels, p.most, start, stop, out
    )
    return out.reshape(stop - start, columns, p.count)


def volume(problem: Problem) -> NDArray[np.int64]:
    found = stored_cost(problem, 0, problem.shape[0])
    assert (found[:, :, problem.searched :] == kernels.PADDING).all()
    return found[:, :, : problem.searched].astype(np.int64)


@pytest.mark.parametrize("shift", [1, 2])
def test_a_shifted_window_is_the_best_of_those_around(shift: int) -> None:
    problem = small_problem(9, 11, 17, 40)
    rows, columns = problem.shape
    windows = stored_cost(problem, 0, rows).reshape(rows, -1)
    expected = np.full((rows, columns, problem.count), 255, np.uint8)
    for y, x in np.ndindex(rows, columns):
        around = np.s_[max(y - shift, 0) : y + shift + 1, max(x - shift, 0) : x + shift + 1]
        expected[y, x] = windows.reshape(rows, columns, -1)[around].min(axis=(0, 1))
    out = np.zeros((6, windows.shape[1]), np.uint8)
    kernels.shift_windows(windows, 3, 9, shift, columns, out)
    np.testing.assert_array_equal(out.reshape(6, columns, -1), expected[3:9])


def same(one: Selection, other: Selection) -> bool:
    pairs = (
        (one.right_cost, other.right_cost),
        (one.disparity, other.disparity),
        (one.right_px, other.right_px),
        (one.ratio, other.ratio),
    )
    return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rows=st.integers(2, 9),
    columns=st.integers(2, 12),
    searched=st.integers(1, 40),
    low=st.integers(-9, 9),
    diagonals=st.booleans(),
)
def test_the_choice_equals_that_of_a_plain_implementation(
    seed: int, rows: int, columns: int, searched: int, low: int, diagonals: bool
) -> None:
    problem = small_problem(seed, rows, columns, searched, low, diagonals)
    total = plain_total(volume(problem), problem)
    found = aggregate(problem, Storage(), None)
    index = total.argmin(axis=2)
    np.testing.assert_array_equal(np.rint(found.disparity - 1e-6 * np.sign(found.disparity - low - index)), low + index)
    best = total.min(axis=2)
    flat = total.max(axis=2) == best
    np.testing.assert_array_equal(np.isnan(found.ratio), flat)
    if searched > 3:
        away = np.abs(np.arange(searched) - index[:, :, None]) > 1
        second = np.where(away, total, 65535).min(axis=2)
        expected = ((second + 1) / (best + 1)).astype(np.float32)
        known = ~flat & away.any(axis=2) & (second < 65535)
        np.testing.assert_array_equal(found.ratio[known], expected[known])
    # A right pixel takes the least cost on its diagonal of the same sums.
    for x in range(columns):
        reached = [(total[:, x + low + d, d], d) for d in range(searched) if 0 <= x + low + d < columns]
        if not reached:
            assert np.isnan(found.right_px[:, x]).all()
            continue
        least = np.min([values for values, _ in reached], axis=0)
        chosen = np.rint(found.right_px[:, x]).astype(int) - low
        for y in range(rows):
            candidates = {d for values, d in reached if values[y] == least[y]}
            assert candidates & {chosen[y] - 1, chosen[y], chosen[y] + 1}


@pytest.mark.parametrize(("searched", "low", "radius"), [(7, -3, 1), (33, 5, 0), (40, 0, 2), (64, -60, 5)])
def test_the_cost_equals_a_plain_implementation(searched: int, low: int, radius: int) -> None:
    problem = small_problem(5, 13, 70, searched, low, radius=radius)
    expected = np.minimum(np.floor(plain_cost(problem)), problem.most)
    np.testing.assert_allclose(volume(problem), expected, atol=1)


def test_a_part_of_the_rows_costs_the_same_as_all_of_them() -> None:
    p = small_problem(6, 20, 12, 32)
    np.testing.assert_array_equal(stored_cost(p, 6, 13), volume(p)[6:13])


@pytest.mark.parametrize("rows", [1, 2, 3, 37, 90])
@pytest.mark.parametrize("shift", [0, 1])
def test_storage_and_threads_change_nothing(rows: int, shift: int) -> None:
    problem = replace(small_problem(8, rows, 50, 40), shift=shift)
    whole = aggregate(problem, Storage(), None)
    with ThreadPoolExecutor(2) as pool:
        assert same(aggregate(problem, Storage(), pool), whole)
        for storage in (Storage(costs=True), *(Storage(strips) for strips in (2, 3, max(rows // 2, 1)))):
            assert same(aggregate(problem, storage, pool), whole)
            assert same(aggregate(problem, storage, None), whole)


def random_pair(rows: int = 80, columns: int = 120, disparity: int = 5) -> Views:
    wide = np.random.default_rng(7).integers(0, 256, (rows, columns + 20)).astype(np.uint8)
    return Views(wide[:, :columns].copy(), wide[:, disparity : disparity + columns].copy())


def test_the_product_depends_neither_on_threads_nor_on_memory() -> None:
    views = random_pair(rows=240, columns=300)
    search = DisparityRange(-20, 80)
    whole = match_gray(views.left, views.right, search, SemiGlobalMatchParams())
    assert plan_storage((240, 300), 100, 400, "matching") == Storage(costs=True)
    assert plan_storage((240, 300), 100, 14, "matching") == Storage()
    assert plan_storage((240, 300), 100, 8, "matching").strips > 1
    for threads, memory_mb in ((1, 400), (1, 16), (2, 16), (1, 11), (2, 11)):
        params = SemiGlobalMatchParams(threads=threads, max_memory_mb=memory_mb)
        assert same(match_gray(views.left, views.right, search, params), whole)


def test_the_guide_in_colour_and_its_depth() -> None:
    rng = np.random.default_rng(3)
    left = np.repeat(rng.integers(80, 120, (40, 60, 1)), 3, axis=2).astype(np.uint8)
    left[:, 30:, 0] += 60  # red and blue change and leave the luminance as it was
    left[:, 30:, 2] -= 57
    views = Views(left, np.roll(left, -3, axis=1))
    gray = Views(
        *(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8) for image in (views.left, views.right))
    )
    search, params = DisparityRange(0, 12), SemiGlobalMatchParams()
    in_colour = state_problem(gray.left, gray.right, search, params, guide=left)
    assert steps_along(in_colour.guide, backward=False)[0, :, 30].min() > 20
    assert steps_along(state_problem(gray.left, gray.right, search, params).guide, backward=False)[0].max() < 60
    eight, sixteen = (
        semi_global_match(Matching(seen, search), params).disparity
        for seen in (views, Views(left.astype(np.uint16) * 257, views.right.astype(np.uint16) * 257))
    )
    assert eight is not None
    assert sixteen is not None
    assert np.nanmedian(np.abs(eight.disparity_px - sixteen.disparity_px)) < 0.05


def test_concurrent_calls_give_what_one_gives() -> None:
    views = [random_pair(disparity=d) for d in (2, 5, 8)]
    params = SemiGlobalMatchParams()

    def run(one: Views) -> Selection:
        return match_gray(one.left, one.right, DisparityRange(0, 12), params)

    alone = [run(one) for one in views]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(run, views * 2))
    assert all(same(one, other) for one, other in zip(alone * 2, together, strict=True))


def test_census_has_a_bit_for_every_darker_pixel() -> None:
    image = np.array([[9, 1, 5], [6, 5, 2], [5, 4, 7]], np.int16)
    offsets = census_offsets("3x3")
    centre = census_bits(image, offsets, 0, False)[0, 1, 1]
    assert [bool(centre >> k & 1) for k in range(8)] == [False, True, False, False, True, False, True, False]
    darker_or_brighter = census_bits(image, offsets, 1, True)[:, 1, 1]
    bits = [bool(darker_or_brighter[k // 8] >> k % 8 & 1) for k in range(16)]
    assert bits[0::2] == [False, True, False, False, True, False, False, False]
    assert bits[1::2] == [True, False, False, False, False, False, False, True]


@pytest.mark.parametrize(("name", "number"), [("3x3", 8), ("5x5", 24), ("7x7", 48), ("9x7", 62), ("9x9_sparse", 32)])
def test_a_census_compares_as_many_pixels_as_its_window_has(name: str, number: int) -> None:
    assert len(census_offsets(name)) == number  # type: ignore[arg-type]


def test_slopes_are_odd_rise_with_the_step_and_do_not_depend_on_gain() -> None:
    def slope_of_step(low: int, high: int) -> int:
        return int(slope_values(np.array([[low] * 9 + [high] * 9] * 9, np.int16) * 16)[4, 8])

    rising = [slope_of_step(80, 80 + k) for k in range(0, 150, 10)]
    assert rising[0] == 128
    assert all(one < other for one, other in itertools.pairwise(rising))
    texture = np.random.default_rng(3).integers(0, 4080, (9, 30)).astype(np.int16)
    np.testing.assert_allclose(slope_values(texture)[:, ::-1], 256.0 - slope_values(texture[:, ::-1].copy()), atol=1)
    assert slope_of_step(140, 200) == pytest.approx(slope_of_step(70, 100), abs=4)


@pytest.mark.parametrize("cost", ["census", "ternary_census", "hybrid", "sobel", "absolute_difference"])
@pytest.mark.parametrize("census", ["3x3", "9x7"])
def test_a_cost_fits_its_bytes(cost: str, census: str) -> None:
    image = np.random.default_rng(1).integers(0, 256, (20, 30)).astype(np.uint8)
    found: Features = compute_features(image, 255 - image, 0, 8, cost, census)  # type: ignore[arg-type]
    assert (8 * (found.left.shape[2] - 1) << found.bit_shift) + found.value_limit <= 255


def test_every_increasing_map_leaves_the_census_result_unchanged() -> None:
    views = random_pair()
    half = Views((views.left // 2).astype(np.uint8), (views.right // 2).astype(np.uint8))
    curved = Views(half.left, np.rint(255 * (half.right / 127.0) ** 0.5).astype(np.uint8))
    params = SemiGlobalMatchParams(cost="census", smooth_px=0.0, subpixel="equiangular")
    one, two = (semi_global_match(Matching(v, DisparityRange(0, 12)), params).disparity for v in (half, curved))
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.disparity_px, two.disparity_px)


@pytest.mark.parametrize("cost", ["census", "ternary_census", "hybrid", "sobel", "absolute_difference"])
@pytest.mark.parametrize("paths", [4, 8])
def test_every_cost_finds_a_shift(cost: str, paths: int) -> None:
    params = SemiGlobalMatchParams(cost=cost, paths=paths)  # type: ignore[arg-type]
    found = semi_global_match(Matching(random_pair(), DisparityRange(0, 12)), params).disparity
    assert found is not None
    assert np.mean(np.abs(found.disparity_px[:, 10:] - 5) < 0.5) > 0.95


def test_the_second_best_cost_exceeds_the_best_and_right_and_left_agree() -> None:
    state = semi_global_match(Matching(random_pair(), DisparityRange(0, 12)), SemiGlobalMatchParams())
    assert state.disparity is not None
    excess = state.disparity.excess
    assert excess is not None
    assert excess[state.disparity.valid].min() >= 0
    assert np.median(excess[state.disparity.valid]) > 0.5
    checked = check_left_right(state, CheckLeftRightParams()).disparity
    assert checked is not None
    assert checked.valid.mean() > 0.9


def test_too_little_memory_is_refused_before_any_is_taken() -> None:
    words = (
        "matching.semi_global_match: 40000x30000 px and 128 disparities need at least 4962 MB, but max_memory_mb is "
        "500; raise it, narrow the range or reduce the images"
    )
    with pytest.raises(OperatorError) as caught:
        plan_storage((30000, 40000), 128, 500, "matching.semi_global_match")
    assert str(caught.value) == words
