"""Range, checks and filters on disparities worked by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from modules.matching.check_left_right import (
    SURFACE_PX,
    SURFACE_RADIUS,
    SURFACE_SHARE,
    CheckLeftRightParams,
    check_left_right,
    continues_surface,
    project_to_right,
)
from modules.matching.common import at_match
from modules.matching.median_filter import MedianFilterParams, median_filter
from modules.matching.remove_speckles import RemoveSpecklesParams, remove_speckles
from modules.matching.use_range import UseRangeParams, use_range
from modules.operator import OperatorError
from modules.types import Disparity, DisparityRange, FloatImage, Invalid, Matching, Views

NAN = np.nan


def state_of(left: list[list[float]], right: list[list[float]] | None = None) -> Matching:
    values = np.array(left, np.float32)
    flags = np.where(np.isnan(values), int(Invalid.NO_MATCH), 0).astype(np.uint16)
    blank = np.zeros(values.shape, np.uint8)
    other = None if right is None else np.array(right, np.float32)
    return Matching(Views(blank, blank), DisparityRange(0, 16), Disparity(values, flags, right_px=other))


def test_the_range_is_set_and_an_empty_one_is_refused() -> None:
    state = state_of([[1.0]])
    assert use_range(state, UseRangeParams(min_px=-3, max_px=5)).range_px == DisparityRange(-3, 5)
    with pytest.raises(OperatorError, match="max_px 5 must be larger than min_px 5"):
        use_range(state, UseRangeParams(min_px=5, max_px=5))


def scattered(seed: int, rows: int = 9, columns: int = 17) -> FloatImage:
    """Return disparities in steps of a quarter, a third of them missing."""
    draw = np.random.default_rng(seed)
    values = draw.integers(-12, 48, (rows, columns)) / 4
    return np.where(draw.random(values.shape) < 0.3, NAN, values).astype(np.float32)


def test_the_nearest_pixel_to_a_match_is_found_where_there_is_one() -> None:
    left, right = scattered(0), scattered(1)
    found, known = at_match(right, left)
    for (row, column), value in np.ndenumerate(left):
        there = np.rint(column - value)  # halves to even
        assert known[row, column] == (0 <= there < left.shape[1])
        if known[row, column]:
            np.testing.assert_array_equal(found[row, column], right[row, int(there)])


def test_a_match_that_does_not_match_back_is_rejected() -> None:
    state = state_of([[NAN, 1.0, 1.0, 3.0]], [[1.0, 1.0, 5.0, NAN]])
    result = check_left_right(state, CheckLeftRightParams()).disparity
    assert result is not None
    np.testing.assert_array_equal(result.valid, [[False, True, True, False]])
    assert result.validity[0, 3] == Invalid.LEFT_RIGHT
    assert result.validity[0, 0] == Invalid.NO_MATCH


def test_unconfirmed_matches_are_kept_or_rejected_as_asked() -> None:
    state = state_of([[NAN, 1.0]], [[NAN, 1.0]])
    kept = check_left_right(state, CheckLeftRightParams()).disparity
    dropped = check_left_right(state, CheckLeftRightParams(unconfirmed="reject")).disparity
    assert kept is not None
    assert dropped is not None
    assert kept.valid[0, 1]
    assert not dropped.valid[0, 1]


def beside_an_edge(back: float, excess: float, confirmed: int = 49) -> bool:
    """Return whether a pixel on a surface of so many pixels is kept if the disparity of its match is `back`, not 2."""
    left = np.full((7, 14), NAN, np.float32)
    surface = left[:, 7:]
    surface.flat[:confirmed] = 2.0
    left[3, 10] = 2.0  # its window is the surface
    right = np.full((7, 14), 2.0, np.float32)
    right[3, 8] = back
    known = np.full((7, 14), excess, np.float32)
    state = state_of(left.tolist(), right.tolist())
    assert state.disparity is not None
    state = replace(state, disparity=replace(state.disparity, excess=known))
    result = check_left_right(state, CheckLeftRightParams(strong_excess=0.25)).disparity
    assert result is not None
    return bool(result.valid[3, 10])


def test_a_pixel_that_does_not_match_back_is_kept_for_a_clear_minimum_on_a_confirmed_surface() -> None:
    assert beside_an_edge(back=9.0, excess=0.25)
    assert not beside_an_edge(back=9.0, excess=0.24)
    assert beside_an_edge(back=9.0, excess=0.25, confirmed=10)
    assert not beside_an_edge(back=9.0, excess=0.25, confirmed=9)


def test_a_surface_goes_on_where_enough_confirmed_pixels_of_the_window_lie_near() -> None:
    draw = np.random.default_rng(2)
    disparity = np.round(scattered(3, 20, 30) / 6).astype(np.float32)
    known = np.isfinite(disparity)
    confirmed = known & (draw.random(disparity.shape) < 0.5)
    asked = known & ~confirmed
    kept = continues_surface(disparity, confirmed, asked)
    for row, column in zip(*np.nonzero(asked), strict=True):
        window = tuple(slice(max(0, at - SURFACE_RADIUS), at + SURFACE_RADIUS + 1) for at in (row, column))
        near = confirmed[window] & (np.abs(disparity[window] - disparity[row, column]) <= SURFACE_PX)
        enough = SURFACE_SHARE * (2 * SURFACE_RADIUS + 1) ** 2
        assert kept[row, column] == (np.count_nonzero(near) >= enough)
    assert 0 < np.count_nonzero(kept) < np.count_nonzero(asked)
    assert not (kept & ~asked).any()


def test_a_pixel_that_would_hide_what_the_right_image_shows_needs_four_times_the_excess() -> None:
    assert not beside_an_edge(back=0.0, excess=0.99)
    assert beside_an_edge(back=0.0, excess=1.0)


def test_without_the_second_best_cost_no_pixel_is_kept() -> None:
    state = state_of([[NAN, 1.0, 1.0, 3.0]], [[1.0, 1.0, 5.0, NAN]])
    plain = check_left_right(state, CheckLeftRightParams()).disparity
    asked = check_left_right(state, CheckLeftRightParams(strong_excess=0.01)).disparity
    assert plain is not None
    assert asked is not None
    np.testing.assert_array_equal(plain.validity, asked.validity)


def test_the_nearer_of_two_pixels_hides_the_other() -> None:
    left = np.array([[NAN, NAN, 1.0, 2.5, 3.0]], np.float32)
    np.testing.assert_array_equal(project_to_right(left)[0, :3], [2.5, 3.0, NAN])
    result = check_left_right(state_of(left.tolist()), CheckLeftRightParams()).disparity
    assert result is not None
    np.testing.assert_array_equal(result.valid, [[False, False, False, True, True]])


def test_islands_up_to_the_size_are_removed_and_larger_ones_kept() -> None:
    grid = np.full((6, 8), 5.0)
    grid[1:3, 1:3] = 9.0
    result = remove_speckles(state_of(grid.tolist()), RemoveSpecklesParams(max_size_px=4)).disparity
    kept = remove_speckles(state_of(grid.tolist()), RemoveSpecklesParams(max_size_px=3)).disparity
    assert result is not None
    assert kept is not None
    assert result.rejected() == {"SPECKLE": 4}
    assert kept.rejected() == {}


def test_speckles_of_very_large_disparities_do_not_overflow() -> None:
    grid = np.full((6, 8), 5000.0)
    grid[1:3, 1:3] = -3000.0
    result = remove_speckles(state_of(grid.tolist()), RemoveSpecklesParams(max_size_px=4)).disparity
    assert result is not None
    assert result.rejected() == {"SPECKLE": 4}


def test_the_median_removes_an_outlier_and_leaves_validity_alone() -> None:
    grid = np.full((5, 5), 4.0)
    grid[2, 2] = 11.0
    grid[0, 0] = NAN
    result = median_filter(state_of(grid.tolist()), MedianFilterParams()).disparity
    assert result is not None
    assert result.disparity_px[2, 2] == 4.0
    np.testing.assert_array_equal(result.valid, ~np.isnan(grid))
    with pytest.raises(OperatorError, match="even"):
        median_filter(state_of(grid.tolist()), MedianFilterParams(size_px=4))


@pytest.mark.parametrize("size_px", [3, 5])
def test_the_median_leaves_holes_out(size_px: int) -> None:
    grid = scattered(4)
    result = median_filter(state_of(grid.tolist()), MedianFilterParams(size_px=size_px)).disparity
    assert result is not None
    padded = np.pad(grid, size_px // 2, mode="edge")
    for (row, column), value in np.ndenumerate(grid):
        window = padded[row : row + size_px, column : column + size_px]
        known = np.sort(window[np.isfinite(window)])
        holes, middle = window.size - known.size, window.size // 2
        wanted = value
        if np.isfinite(value) and known.size > middle:  # median with the holes below all, and above all
            wanted = np.clip(value, known[middle - holes], known[middle])
        np.testing.assert_array_equal(result.disparity_px[row, column], wanted)


def test_checks_without_a_disparity_are_refused() -> None:
    empty = Matching(Views(np.zeros((3, 3), np.uint8), np.zeros((3, 3), np.uint8)))
    with pytest.raises(OperatorError, match="run a matcher first"):
        check_left_right(empty, CheckLeftRightParams())
    with pytest.raises(OperatorError, match="run a matcher first"):
        remove_speckles(empty, RemoveSpecklesParams())
