"""Refinement by intensities: what it reaches, what it leaves alone, and that it does not depend on threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.matching.kernels import refinement
from modules.matching.refine_subpixel import Window, refine_by_intensity, room_with_margins
from modules.matching.semi_global_match import SemiGlobalMatchParams, semi_global_match
from modules.operator import OperatorError
from modules.types import DisparityRange, Matching, Views


def textured(rows: int, columns: int) -> NDArray[np.float32]:
    noise = np.random.default_rng(3).normal(0, 1, (rows, columns)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.2)
    return np.asarray(128 + 40 * smooth / smooth.std(), np.float32)


def slanted_pair(gain: float = 1.0, offset: float = 0.0) -> tuple[Views, NDArray[np.float32]]:
    """Return a pair whose left image is the right one, displaced by 4 to 8 px across the columns."""
    right = textured(60, 200)
    truth = np.broadcast_to(np.linspace(4, 8, 200, dtype=np.float32), (60, 200))
    down = np.repeat(np.arange(60, dtype=np.float32)[:, None], 200, axis=1)
    left = cv2.remap(right, np.arange(200, dtype=np.float32) - truth, down, cv2.INTER_LANCZOS4)
    images = [np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in (left, gain * right + offset)]
    return Views(*images), np.asarray(truth)


def refined(views: Views, disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    with ThreadPoolExecutor(2) as pool:
        return refine_by_intensity(views.left, views.right, disparity, DisparityRange(-8, 64), pool)  # type: ignore[arg-type]


@pytest.mark.parametrize("error", [-0.2, 0.1, 0.2])
@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.6, 30.0)])
def test_a_small_error_shrinks_to_a_fraction_whatever_the_gain_and_offset(
    error: float, gain: float, offset: float
) -> None:
    views, truth = slanted_pair(gain, offset)
    found = refined(views, truth + np.float32(error))
    assert np.median(np.abs(found - truth)[:, 12:-12]) < 0.35 * abs(error)


def test_without_texture_the_disparity_stays() -> None:
    flat = np.full((20, 40), 90, np.uint8)
    disparity = np.full((20, 40), 3.3, np.float32)
    np.testing.assert_array_equal(refined(Views(flat, flat), disparity), disparity)


def test_no_disparity_moves_further_than_the_limits_even_where_nothing_fits() -> None:
    rng = np.random.default_rng(8)
    left, right = rng.integers(0, 256, (2, 30, 50)).astype(np.uint8)
    disparity = rng.uniform(0, 6, (30, 50)).astype(np.float32)
    moved = np.abs(refined(Views(left, right), disparity) - disparity)
    assert moved.max() <= refinement.SMOOTH_LIMIT + refinement.STEP_LIMIT + 1e-5


def test_beside_the_border_of_the_right_image_what_lies_beyond_it_does_not_count() -> None:
    scene = np.clip(np.rint(textured(40, 90)), 0, 255).astype(np.uint8)
    views = Views(scene[:, :80].copy(), scene[:, 10:].copy())
    truth = np.full((40, 80), 10, np.float32)
    start = truth.copy()
    start[:, :13] -= np.float32(0.3)  # as a curve through costs of windows that reach over the border errs
    found = refined(views, start)
    assert np.abs(found - truth)[:, 10:13].mean() < 0.1
    elsewhere = np.abs(found - truth)[:, 20:]
    assert elsewhere.max() < 0.01


def with_margins(image: NDArray[Any], radius: int) -> NDArray[np.float32]:
    out = room_with_margins(image.shape, radius)
    out[:, radius : radius + image.shape[1]] = image
    return out


def test_parts_of_the_rows_are_refined_like_the_whole() -> None:
    views, truth = slanted_pair()
    rows, columns = truth.shape
    left, right, px = (with_margins(image, 2) for image in (views.left, views.right, truth))
    whole, parts = np.zeros((2, *px.shape), np.float32), np.zeros((2, *px.shape), np.float32)
    for bounds, out in (((0, rows),), whole), (((0, 13), (13, rows)), parts):
        for start, stop in bounds:
            refinement.smooth_rows(px + np.float32(0.1), columns, 2, 2, start, stop, out[0])
            refinement.fit_rows(left, right, right, px, px, columns, 2, 2, 5.0, start, stop, out[1])
    assert np.isfinite(whole[:, :, 2 : 2 + columns]).all()
    np.testing.assert_array_equal(whole, parts)


def test_under_noise_a_wider_window_and_more_steps_come_nearer() -> None:
    views, truth = slanted_pair()
    noisy = views.right + np.random.default_rng(4).normal(0, 25, truth.shape)
    right = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    left, start = np.asarray(views.left, np.uint8), truth + np.float32(0.2)

    def error(window: Window) -> float:
        found = refine_by_intensity(left, right, start, DisparityRange(0, 32), None, window)
        return float(np.median(np.abs(found - truth)[:, 12:-12]))

    assert error(Window(3, 3, 3)) < 0.9 * error(Window())
    assert error(Window()) < 0.2  # the start
    assert error(Window(3, 3, 3, 1.5)) < 0.9 * error(Window(3, 3, 3))


def test_a_wide_and_low_window_keeps_relief_from_row_to_row() -> None:
    rows, columns = np.mgrid[:60, :200].astype(np.float32)
    truth = (8.0 + 0.3 * np.sin(2.0 * np.pi * rows / 8.0)).astype(np.float32)
    rng = np.random.default_rng(7)
    right = cv2.GaussianBlur(rng.uniform(0, 255, truth.shape).astype(np.float32), (0, 0), 1.2)
    right = 128 + 3 * (right - 128)
    left = cv2.remap(right, columns - truth, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    images = [np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in (left, right)]

    def error(window: Window) -> float:
        found = refine_by_intensity(images[0], images[1], truth, DisparityRange(0, 32), None, window)
        return float(np.median(np.abs(found - truth)[:, 20:-20]))

    assert error(Window(7, 1)) < 0.5 * error(Window(3, 3))


def test_the_mean_of_the_channels_sees_texture_that_the_luminance_drowns_in_noise() -> None:
    views, truth = slanted_pair()
    rng = np.random.default_rng(6)

    def coloured(gray: NDArray[np.uint8]) -> NDArray[np.uint8]:
        noisy = gray[..., None] + rng.normal(0, 40, (*gray.shape, 3))
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    pair = Views(coloured(np.asarray(views.left)), coloured(np.asarray(views.right)))
    off = {}
    for gray in ("luminance", "mean"):
        params = SemiGlobalMatchParams.model_validate({"gray": gray})
        disparity = semi_global_match(Matching(pair, DisparityRange(0, 16)), params).disparity
        assert disparity is not None
        off[gray] = float(np.nanmedian(np.abs(disparity.disparity_px - truth)[:, 12:-12]))
    assert off["mean"] < off["luminance"]


def test_an_even_window_of_the_refinement_is_refused() -> None:
    views, _ = slanted_pair()
    with pytest.raises(OperatorError, match="refine_px 6 is even; use 7"):
        semi_global_match(Matching(views, DisparityRange(0, 16)), SemiGlobalMatchParams(refine_px=6))
    with pytest.raises(OperatorError, match="refine_rows_px 4 is even; use 5"):
        semi_global_match(Matching(views, DisparityRange(0, 16)), SemiGlobalMatchParams(refine_rows_px=4))


def test_matching_locks_less_to_whole_pixels_with_it_than_without() -> None:
    views, truth = slanted_pair()
    inner = slice(12, -12)
    bias = {}
    for subpixel in ("equiangular", "intensity"):
        params = SemiGlobalMatchParams.model_validate({"subpixel": subpixel})
        disparity = semi_global_match(Matching(views, DisparityRange(0, 16)), params).disparity
        assert disparity is not None
        fraction = truth[:, inner] - np.rint(truth[:, inner])
        pull = (disparity.disparity_px - truth)[:, inner] * np.sign(fraction)
        bias[subpixel] = abs(float(np.nanmedian(pull[np.abs(fraction) > 0.1])))
    assert bias["intensity"] < 0.02
    assert bias["intensity"] < bias["equiangular"]
