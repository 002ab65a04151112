"""Matchers on synthetic pairs with known disparity."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.matching import OPERATORS
from modules.operator import OperatorError
from modules.types import DisparityRange, Invalid, Matching, Views

BY_NAME = {operator.name: operator for operator in OPERATORS}
MATCHERS = [operator.name for operator in OPERATORS if operator.slot == "matcher"]
CHECKS = ("matching.check_left_right", "matching.check_uniqueness", "matching.remove_speckles")


def texture(rows: int, columns: int, seed: int, channels: int = 0) -> NDArray[np.uint8]:
    shape = (rows, columns, channels) if channels else (rows, columns)
    noise = np.random.default_rng(seed).normal(0, 1, shape).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.2)
    smooth = 128 + 45 * smooth / smooth.std()
    return np.clip(np.rint(smooth), 0, 255).astype(np.uint8)


def shifted(disparity: int, rows: int = 60, columns: int = 140, seed: int = 1, channels: int = 0) -> Views:
    wide = texture(rows, columns + 200, seed, channels)
    left = wide[:, 100 : 100 + columns]
    right = wide[:, 100 + disparity : 100 + disparity + columns]
    return Views(np.ascontiguousarray(left), np.ascontiguousarray(right))


def match(views: Views, low: int, high: int, name: str, **params: object) -> Matching:
    operator = BY_NAME[name]
    return operator.function(Matching(views, DisparityRange(low, high)), operator.params(**params))


def apply(state: Matching, name: str, **params: object) -> Matching:
    return BY_NAME[name].function(state, BY_NAME[name].params(**params))


@pytest.mark.parametrize("name", MATCHERS)
@pytest.mark.parametrize(
    ("disparity", "low", "high"), [(7, 0, 16), (7, 3, 20), (-9, -20, -2), (-4, -16, 16), (0, -8, 8), (30, 21, 40)]
)
def test_a_shift_is_found_wherever_its_match_exists(name: str, disparity: int, low: int, high: int) -> None:
    state = match(shifted(disparity), low, high, name)
    assert state.disparity is not None
    columns = np.arange(140)
    inside = (columns - disparity >= 8) & (columns - disparity <= 131)
    found = state.disparity.disparity_px[:, inside]
    assert np.mean(np.abs(found - disparity) < 0.5) > 0.93
    assert state.disparity.disparity_px.dtype == np.float32


@pytest.mark.parametrize("name", MATCHERS)
def test_no_valid_match_lies_outside_the_right_image(name: str) -> None:
    for disparity, low, high in ((40, 0, 64), (-40, -64, 0)):
        result = match(shifted(disparity), low, high, name).disparity
        assert result is not None
        target = np.arange(140) - result.disparity_px
        seen = target[np.isfinite(target)]
        assert seen.min() >= -0.5
        assert seen.max() <= 139.5
        assert result.rejected()["OUTSIDE"] > 0


@pytest.mark.parametrize("name", MATCHERS)
def test_every_pixel_is_either_valid_or_has_a_reason(name: str) -> None:
    state = match(shifted(7), 0, 20, name)
    for check in CHECKS:
        state = apply(state, check)
        assert state.disparity is not None
        np.testing.assert_array_equal(state.disparity.valid, state.disparity.validity == 0)


@pytest.mark.parametrize("name", MATCHERS)
def test_disparities_stay_in_the_searched_range(name: str) -> None:
    result = match(shifted(25), 0, 20, name).disparity
    assert result is not None
    assert np.nanmin(result.disparity_px, initial=19.0) >= 0.0
    assert np.nanmax(result.disparity_px, initial=0.0) <= 19.0


@pytest.mark.parametrize("name", MATCHERS)
def test_a_slanted_plane_is_followed_to_a_third_of_a_pixel(name: str) -> None:
    rows, columns = 60, 160
    right = texture(rows, columns + 60, 5)
    grid_row, grid_column = np.mgrid[0:rows, 0:columns].astype(np.float32)
    truth = 8 + 0.06 * grid_column + 0.05 * grid_row
    left = cv2.remap(right, grid_column + 30 - truth, grid_row, cv2.INTER_CUBIC)
    state = match(Views(left, np.ascontiguousarray(right[:, 30 : 30 + columns])), 0, 32, name)
    assert state.disparity is not None
    error = np.abs(state.disparity.disparity_px - truth)[:, 24:-8]
    assert np.nanmedian(error) < 0.34
    assert np.mean(error < 1.0) > 0.9


@pytest.mark.parametrize("name", MATCHERS)
def test_unrelated_images_leave_almost_nothing_after_the_checks(name: str) -> None:
    state = match(Views(texture(100, 160, 1), texture(100, 160, 2)), 0, 48, name)
    for check in CHECKS:
        state = apply(state, check)
    assert state.disparity is not None
    assert state.disparity.valid.mean() <= 0.05


@pytest.mark.parametrize("name", MATCHERS)
def test_unrelated_images_leave_little_even_without_the_uniqueness_check(name: str) -> None:
    state = match(Views(texture(200, 300, 1), texture(200, 300, 2)), 0, 64, name)
    state = apply(apply(state, "matching.check_left_right"), "matching.remove_speckles", max_size_px=200)
    assert state.disparity is not None
    assert state.disparity.valid.mean() <= 0.05


@pytest.mark.parametrize("name", MATCHERS)
def test_masked_pixels_and_pixels_whose_match_is_masked_are_rejected(name: str) -> None:
    views = shifted(7)
    left_mask = np.ones(views.shape, bool)
    left_mask[20:30, 50:60] = False
    right_mask = np.ones(views.shape, bool)
    right_mask[40:50, 80:90] = False
    result = match(Views(views.left, views.right, left_mask, right_mask), 0, 16, name).disparity
    assert result is not None
    assert not result.valid[20:30, 50:60].any()
    assert np.all(result.validity[20:30, 50:60] & Invalid.MASKED)
    assert not result.valid[41:49, 88:96].any()
    assert np.mean((result.validity[41:49, 88:96] & Invalid.MASKED) != 0) > 0.9


@pytest.mark.parametrize("name", MATCHERS)
def test_sixteen_bits_give_what_eight_bits_give(name: str) -> None:
    views = shifted(7)
    deep = Views(views.left.astype(np.uint16) * 16, views.right.astype(np.uint16) * 16)
    one, two = (match(v, 0, 16, name).disparity for v in (views, deep))
    assert one is not None
    assert two is not None
    both = one.valid & two.valid
    assert both.mean() > 0.8
    assert np.mean(np.abs(one.disparity_px - two.disparity_px)[both] < 0.5) > 0.99


@pytest.mark.parametrize("name", MATCHERS)
def test_colour_images_are_matched_and_inputs_are_not_modified(name: str) -> None:
    views = shifted(7, channels=3)
    before = views.left.copy(), views.right.copy()
    result = match(views, 0, 16, name).disparity
    assert result is not None
    assert np.mean(np.abs(result.disparity_px[:, 20:] - 7) < 0.5) > 0.9
    np.testing.assert_array_equal(views.left, before[0])
    np.testing.assert_array_equal(views.right, before[1])


@pytest.mark.parametrize("name", MATCHERS)
def test_matching_is_deterministic(name: str) -> None:
    one, two = (match(shifted(7), 0, 20, name).disparity for _ in range(2))
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.disparity_px, two.disparity_px)
    np.testing.assert_array_equal(one.validity, two.validity)


@pytest.mark.parametrize("name", MATCHERS)
@pytest.mark.parametrize(
    ("make", "low", "high", "words"),
    [
        (lambda: shifted(3, 4, 140), 0, 16, "window"),
        (lambda: shifted(3), 0, 500, "does not fit the image width of 140 px"),
        (lambda: shifted(3), 200, 220, "does not fit the image width of 140 px"),
        (lambda: Views(np.full((60, 90), 9, np.uint8), np.full((60, 90), 9, np.uint8)), 0, 16, "one value 9"),
    ],
)
def test_unusable_input_is_refused_in_words(
    name: str, make: Callable[[], Views], low: int, high: int, words: str
) -> None:
    with pytest.raises(OperatorError, match=words):
        match(make(), low, high, name)


@pytest.mark.parametrize("name", MATCHERS)
def test_a_missing_range_is_refused(name: str) -> None:
    with pytest.raises(OperatorError, match="use_range"):
        BY_NAME[name].function(Matching(shifted(3)), BY_NAME[name].params())


def test_block_matching_is_that_of_opencv_where_opencv_matches() -> None:
    views, count, block = shifted(7), 32, 15
    plain = cv2.StereoBM.create(count, block)
    plain.setPreFilterType(cv2.STEREO_BM_PREFILTER_XSOBEL)
    plain.setUniquenessRatio(10)
    fixed = plain.compute(views.left, views.right)
    state = match(views, 0, count, "matching.block_match", block_px=block)
    assert state.disparity is not None
    inner = slice(block, -block), slice(count - 1 + block, -block)  # where no block or its filter sees the border
    assert (fixed[inner] >= 0).all()
    np.testing.assert_array_equal(state.disparity.disparity_px[inner], fixed[inner] / 16.0)


@pytest.mark.parametrize("name", ["matching.block_match", "matching.semi_global_block_match"])
def test_no_row_or_column_is_lost_at_the_border(name: str) -> None:
    found = match(shifted(2), 0, 32, name, uniqueness_percent=0).disparity
    assert found is not None
    assert found.valid[0, 2:].all()
    assert found.valid[-1, 2:].all()
    assert found.valid[:, 2:].mean() > 0.99
