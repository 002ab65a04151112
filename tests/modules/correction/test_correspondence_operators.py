"""Operators that compare what both images show at the same points."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from modules.correction.calibrate_segments import CalibrateSegmentsParams, calibrate_segments
from modules.correction.fit_response import FitResponseParams, fit_response
from modules.correction.level_gain_field import LevelGainFieldParams, level_gain_field
from modules.correction.match_sharpness import COLUMNS, PATCH_PX, MatchSharpnessParams, match_sharpness, unpacked
from modules.correction.transfer_local_affine import TransferLocalAffineParams, transfer_local_affine
from modules.operator import OperatorError
from modules.primitives.segments import find_segments, match_segments
from modules.types import Views

SHIFT_PX = 16
HEIGHT, WIDTH = 240, 320


def scene(seed: int = 0, colour: bool = False) -> np.ndarray:
    """Return patches of flat brightness with weak texture: edges, surfaces beside them, and something to match."""
    random = np.random.default_rng(seed)
    values = np.full((HEIGHT, WIDTH + SHIFT_PX, 3), 110.0)
    for _ in range(120):
        x, y = random.integers(0, WIDTH), random.integers(0, HEIGHT)
        width, height = random.integers(12, 60, 2)
        values[y : y + height, x : x + width] = random.uniform(40, 200) + random.uniform(-15, 15, 3)
    values += 4 * cv2.GaussianBlur(random.normal(size=values.shape).astype(np.float32), (0, 0), 1.0) * 3
    values = np.clip(cv2.GaussianBlur(values, (0, 0), 0.7), 20, 230)
    return values if colour else values[..., 1]


def views(change, seed: int = 0, colour: bool = False, dtype: type = np.uint8) -> tuple[Views, np.ndarray]:
    """Return a pair whose right image was changed, and the right image as it should be."""
    both = scene(seed, colour)
    scale = np.iinfo(dtype).max / 255
    left, right = both[:, :WIDTH], both[:, SHIFT_PX:]
    stored = [np.clip(np.rint(x * scale), 0, np.iinfo(dtype).max).astype(dtype) for x in (left, change(right), right)]
    return Views(stored[0], stored[1]), stored[2]


def error_dn(image: np.ndarray, wanted: np.ndarray) -> float:
    """Return the mean difference in dn, away from the border that only one image sees."""
    inner = (slice(8, -8), slice(8, -SHIFT_PX - 8))
    return float(np.abs(image.astype(float) - wanted)[inner].mean() * 255 / np.iinfo(image.dtype).max)


def position() -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    return 2 * x / (WIDTH - 1) - 1, 2 * y / (HEIGHT - 1) - 1


def radial(image: np.ndarray) -> np.ndarray:
    x, y = position()
    return image * (1 - 0.4 * (x**2 + (0.75 * y) ** 2) / (1 + 0.75**2))


def plane(image: np.ndarray) -> np.ndarray:
    x, y = position()
    return image * np.exp(0.25 * x - 0.15 * y - 0.2)


def spot(image: np.ndarray) -> np.ndarray:
    x, y = position()
    return np.clip(image * 0.8 * (1 + 0.5 * np.exp(-((x - 0.2) ** 2 + y**2) / 0.18)), 0, 255)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    ("model", "change"),
    [
        ("gain", lambda image: 0.7 * image),
        ("gain_offset", lambda image: 0.6 * image + 20),
        ("gain_offset_gamma", lambda image: 200 * (image / 255) ** 1.6 + 10),
        ("gain_offset_gamma", lambda image: 230 * (image / 255) ** 0.7),
    ],
)
def test_a_known_response_is_undone_within_two_levels(model, change, dtype):
    pair, wanted = views(change, dtype=dtype)
    before = error_dn(pair.right, wanted)
    after = error_dn(fit_response(pair, FitResponseParams(model=model)).right, wanted)
    assert before > 10
    assert after < 2.0


def test_the_other_image_can_be_the_reference():
    pair, _ = views(lambda image: 0.7 * image)
    result = fit_response(pair, FitResponseParams(reference="right"))
    assert result.right is pair.right
    assert error_dn(result.left, 0.7 * pair.left) < 2.0


def test_each_channel_gets_a_gain_of_its_own():
    pair, wanted = views(lambda image: image * (0.6, 0.8, 0.95), colour=True)
    each = fit_response(pair, FitResponseParams(model="gain", channels="each"))
    gray = fit_response(pair, FitResponseParams(model="gain", channels="gray"))
    assert error_dn(each.right, wanted) < 2.0
    assert error_dn(gray.right, wanted) > 8


@pytest.mark.parametrize(("shape", "change"), [("radial", radial), ("plane", plane), ("quadratic", plane)])
def test_a_field_of_the_known_shape_is_undone(shape, change):
    pair, wanted = views(change)
    before = error_dn(pair.right, wanted)
    after = error_dn(level_gain_field(pair, LevelGainFieldParams(shape=shape)).right, wanted)
    assert after < min(2.5, 0.25 * before)


def test_a_radial_field_does_not_undo_a_gradient():
    pair, wanted = views(plane)
    assert error_dn(level_gain_field(pair, LevelGainFieldParams(shape="radial")).right, wanted) > 8


@pytest.mark.parametrize("change", [radial, plane, spot, lambda image: 0.5 * image + 30])
def test_local_transfer_undoes_light_of_any_soft_shape(change):
    pair, wanted = views(change)
    before = error_dn(pair.right, wanted)
    after = error_dn(transfer_local_affine(pair, TransferLocalAffineParams()).right, wanted)
    assert after < 0.4 * before


def test_masked_light_does_not_spread():
    pair, wanted = views(lambda image: 0.7 * image)
    spoiled = pair.right.copy()
    spoiled[60:120, 100:180] = 255
    mask = np.ones(pair.shape, bool)
    mask[60:120, 100:180] = False
    result = transfer_local_affine(Views(pair.left, spoiled, None, mask), TransferLocalAffineParams())
    assert error_dn(np.where(mask, result.right, wanted), wanted) < 4


def test_segments_correspond_at_the_shift_of_the_scene():
    pair, _ = views(lambda image: 0.6 * image + 15)
    left, right = find_segments(pair.left), find_segments(pair.right)
    matched = match_segments(left, right, 0, 60)
    assert len(matched) >= 20
    shift = np.nanmean(left.columns[matched[:, 0]] - right.columns[matched[:, 1]], axis=1)
    assert np.mean(np.abs(shift - SHIFT_PX) < 1) > 0.95


def test_segments_of_opposite_contrast_do_not_correspond():
    pair, _ = views(lambda image: 255 - image)
    left, right = find_segments(pair.left), find_segments(pair.right)
    matched = match_segments(left, right, SHIFT_PX - 2, SHIFT_PX + 2)
    assert len(matched) == 0


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("colour", [False, True])
def test_segments_calibrate_gain_and_offset(colour, dtype):
    pair, wanted = views(lambda image: 0.6 * image + 15, colour=colour, dtype=dtype)
    assert error_dn(calibrate_segments(pair, CalibrateSegmentsParams()).right, wanted) < 2.0


@pytest.mark.parametrize(
    ("operator", "params", "words"),
    [
        (calibrate_segments, CalibrateSegmentsParams(), "which needs no edges"),
        (fit_response, FitResponseParams(), "hardly any corresponding points"),
        (transfer_local_affine, TransferLocalAffineParams(), "hardly any corresponding points"),
        (level_gain_field, LevelGainFieldParams(), "hardly any corresponding points"),
    ],
)
def test_images_too_small_to_match_are_refused_in_words(operator, params, words):
    image = np.random.default_rng(0).integers(0, 255, (12, 14)).astype(np.uint8)
    with pytest.raises(OperatorError, match=words):
        operator(Views(image, image.copy()), params)


@pytest.mark.parametrize("sigma", [0.8, 1.3, 2.0])
def test_the_sharper_image_is_blurred_by_what_the_other_lacks(sigma):
    pair, wanted = views(lambda image: 0.8 * cv2.GaussianBlur(image, (0, 0), sigma) + 10)
    del wanted
    result = match_sharpness(pair, MatchSharpnessParams())
    assert result.right is pair.right
    expected = cv2.GaussianBlur(pair.left, (0, 0), sigma)
    off = np.abs(result.left.astype(float) - expected).mean()
    assert off < 0.25 * np.abs(pair.left.astype(float) - expected).mean()


def test_equally_sharp_images_stay_as_they_are():
    pair, _ = views(lambda image: 0.8 * image + 10)
    assert match_sharpness(pair, MatchSharpnessParams()) is pair


def test_the_packed_spectrum_is_read_as_numpy_has_it():
    patch = np.random.default_rng(2).normal(0, 10, (PATCH_PX, PATCH_PX)).astype(np.float32)
    wanted = np.abs(np.fft.rfft2(patch.astype(np.float64))[:, :COLUMNS]) ** 2
    np.testing.assert_allclose(unpacked(cv2.dft(patch).astype(np.float64) ** 2), wanted, rtol=1e-3, atol=1.0)


def test_noise_is_not_taken_for_sharpness():
    noise = np.random.default_rng(1).normal(0, 6, (HEIGHT, WIDTH))
    pair, _ = views(lambda image: image + noise)
    assert match_sharpness(pair, MatchSharpnessParams()) is pair
