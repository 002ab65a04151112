import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.primitives.coarse import coarse_match
from modules.primitives.features import track_corners
from modules.primitives.rows import RowModel, fit_rows

SHIFT_PX = 24


def texture(seed: int = 0, width: int = 560) -> NDArray[np.uint8]:
    random = np.random.default_rng(seed)
    layers = [cv2.GaussianBlur(random.normal(size=(300, width)), (0, 0), sigma) for sigma in (1.5, 4.0, 12.0)]
    return np.clip(np.rint(125 + 18 * sum(x / x.std() for x in layers)), 0, 255).astype(np.uint8)


def pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    wide = texture()
    return wide[:, : 560 - SHIFT_PX].copy(), wide[:, SHIFT_PX:].copy()


@pytest.mark.parametrize("curve", [lambda x: x, lambda x: 0.5 * x + 30, lambda x: 255 * (x / 255) ** 1.6])
def test_a_shift_is_found_under_any_increasing_map(curve) -> None:
    left, right = pair()
    match = coarse_match(left, np.rint(curve(right.astype(float))).astype(np.uint8), -100, 200)
    assert match is not None
    assert match.valid_fraction > 0.85
    assert np.nanmedian(match.disparity_px) / match.factor == pytest.approx(SHIFT_PX, abs=0.2)
    assert np.nanpercentile(match.visible(), (2, 98)) / match.factor == pytest.approx(SHIFT_PX, abs=1)


def test_columns_without_a_counterpart_are_not_visible() -> None:
    left, right = pair()
    match = coarse_match(left, right, -100, 200)
    assert match is not None
    assert np.isnan(match.visible()[:, : int(SHIFT_PX * match.factor)]).all()
    swapped = coarse_match(right, left, -100, 200)
    assert swapped is not None
    assert np.isnan(swapped.visible()[:, -int(SHIFT_PX * match.factor) :]).all()


def test_the_disparity_at_a_point_is_in_px_of_the_image() -> None:
    left, right = pair()
    match = coarse_match(left, right, -100, 200)
    assert match is not None
    assert match.disparity_at(np.array([[300.0, 150.0], [5.0, 5.0]], np.float32))[0] == pytest.approx(SHIFT_PX, abs=0.5)


def test_tiny_images_and_unrelated_flat_ones_give_no_match() -> None:
    tiny = np.full((20, 300), 9, np.uint8)
    assert coarse_match(tiny, tiny, 0, 20) is None


def test_tracked_corners_are_precise_to_a_twentieth_of_a_pixel_under_a_change_of_light() -> None:
    left, right = pair()
    matrix = np.array([[1.0, 0.0, -0.4], [0.0, 1.0, 0.7]])
    moved = cv2.warpAffine(0.6 * right + 20, matrix, right.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=4)
    moved = np.rint(moved + np.random.default_rng(1).normal(0, 2, moved.shape)).astype(np.uint8)
    match = coarse_match(left, moved, -100, 200)
    assert match is not None
    matches, corners = track_corners(left, moved, match)
    assert len(matches) > 0.8 * corners
    difference = matches.left_xy - matches.right_xy  # warpAffine itself is exact to 1/64 px only
    assert np.median(difference[:, 0]) == pytest.approx(SHIFT_PX + 0.4, abs=0.05)
    assert np.median(difference[:, 1]) == pytest.approx(-0.7, abs=0.05)
    fit = fit_rows(matches, (left.shape[0], left.shape[1]))
    assert fit is not None
    assert fit.model.offset_px == pytest.approx(0.7, abs=0.05)
    assert fit.residual_px < 0.15


def test_corners_of_wide_images_are_tracked_at_a_smaller_size_without_a_bias() -> None:
    wide = cv2.resize(texture(), None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    left, right = wide[:, :-60].copy(), wide[:, 60:].copy()
    match = coarse_match(left, right, -100, 300)
    assert match is not None
    matches, _ = track_corners(left, right, match)
    assert np.median(matches.left_xy - matches.right_xy, axis=0) == pytest.approx([60, 0], abs=0.05)


def test_corners_of_unrelated_images_do_not_return() -> None:
    left, right = texture(1), texture(2)
    match = coarse_match(left, right, -100, 200)
    assert match is None or len(track_corners(left, right, match)[0]) < 20


def test_the_root_mean_square_misalignment_is_that_over_all_pixels() -> None:
    model, shape = RowModel(0.4, 0.01, -0.005), (30, 50)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    every = model.rows_below(x, y, shape)
    assert model.rms_px(shape) == pytest.approx(float(np.sqrt(np.mean(every**2))), rel=1e-9)
