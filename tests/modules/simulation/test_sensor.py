"""Camera faults do what they say, and nothing by default."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from modules.simulation import (
    REFERENCE_DISTORTIONS,
    SensorParams,
    apply_sensor,
    distort_right,
    scale_distortion,
)
from modules.types import Views

RAMP = np.tile(np.arange(256, dtype=np.uint8), (64, 1))


def picture(dtype: type = np.uint8, colour: bool = True) -> np.ndarray:
    rng = np.random.default_rng(1)
    top = np.iinfo(dtype).max
    return rng.integers(0, top, (60, 80, 3) if colour else (60, 80), dtype=dtype, endpoint=True)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("colour", [False, True])
def test_the_default_camera_changes_nothing(dtype: type, colour: bool) -> None:
    image = picture(dtype, colour)
    out = apply_sensor(image, SensorParams())
    assert out is not image
    assert np.array_equal(out, image)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("name", list(REFERENCE_DISTORTIONS))
def test_shape_and_dtype_stay_and_the_input_is_not_modified(dtype: type, name: str) -> None:
    image = picture(dtype)
    before = image.copy()
    out = apply_sensor(image, REFERENCE_DISTORTIONS[name], seed=2)
    assert (out.shape, out.dtype) == (image.shape, image.dtype)
    assert np.array_equal(image, before)
    assert np.array_equal(out, apply_sensor(image, REFERENCE_DISTORTIONS[name], seed=2))


@pytest.mark.parametrize(
    "params", [SensorParams(gain=0.6, offset_dn=20.0), SensorParams(gamma=(0.7, 1.8, 1.0)), SensorParams(gain=2.0)]
)
def test_a_response_is_monotone(params: SensorParams) -> None:
    out = apply_sensor(RAMP, params)[0].astype(int)
    assert np.all(np.diff(out) >= 0)


def test_gain_and_offset_are_exact_and_clip() -> None:
    out = apply_sensor(RAMP, SensorParams(gain=1.5, offset_dn=10.0))
    assert np.array_equal(out[0], np.clip(np.rint(1.5 * np.arange(256) + 10), 0, 255))


def test_the_curve_variant_is_the_published_formula_in_rgb_order() -> None:
    image = picture()
    out = apply_sensor(image, REFERENCE_DISTORTIONS["curve"])
    f = image / 255.0
    for channel, gamma, cast in ((0, 0.9, 1.1), (1, 1.2, 1.0), (2, 1.5, 0.9)):
        expected = np.clip(np.rint(255 * f[..., channel] ** gamma * cast), 0, 255)
        assert np.abs(out[..., channel] - expected).max() <= 1  # order of multiplication, at halves


def test_gray_and_colour_images_get_the_same_neutral_response() -> None:
    gray = picture(colour=False)
    params = SensorParams(gain=0.8, gamma=(1.3, 1.3, 1.3), offset_dn=5.0, vignetting=0.3)
    out = apply_sensor(np.dstack([gray] * 3), params)
    assert np.array_equal(out[..., 0], apply_sensor(gray, params))


def test_vignetting_keeps_the_centre_and_darkens_the_corners_by_its_value() -> None:
    image = np.full((101, 101), 200, np.uint8)
    out = apply_sensor(image, SensorParams(vignetting=0.55))
    assert out[50, 50] == 200
    assert out[0, 0] == 90
    assert np.array_equal(out, out[::-1, ::-1])


def test_local_light_has_a_bright_spot_and_a_hard_shadow() -> None:
    image = np.full((200, 300), 100, np.uint8)
    out = apply_sensor(image, REFERENCE_DISTORTIONS["local"]).astype(int)
    assert out.max() == 180
    middle = out[100]
    assert np.count_nonzero(np.abs(np.diff(middle)) > 30) == 2
    assert middle[210] < 50


def test_noise_has_its_sigma_and_no_mean() -> None:
    image = np.full((300, 300), 128, np.uint8)
    difference = apply_sensor(image, SensorParams(noise_sigma_dn=12.0), seed=5).astype(float) - 128
    assert abs(difference.mean()) < 0.2  # standard error 0.04
    assert difference.std() == pytest.approx(12.0, rel=0.02)
    assert not np.array_equal(apply_sensor(image, SensorParams(noise_sigma_dn=12.0), seed=6), difference + 128)


def test_the_variance_of_shot_noise_is_the_signal_over_the_electrons_per_dn() -> None:
    for level in (50, 200):
        out = apply_sensor(np.full((300, 300), level, np.uint8), SensorParams(electrons_per_dn=4.0)).astype(float)
        # Rounding adds 1/12.
        assert out.var() == pytest.approx(level / 4 + 1 / 12, rel=0.03)


def test_blur_widens_an_impulse_to_its_sigma() -> None:
    image = np.zeros((41, 41), np.uint16)
    image[20, 20] = 65535
    out = apply_sensor(image, SensorParams(blur_sigma_px=1.3)).astype(float)
    away = np.arange(41) - 20.0
    assert out.sum() == pytest.approx(65535, rel=0.01)
    assert np.sqrt((out.sum(axis=0) * away**2).sum() / out.sum()) == pytest.approx(1.3, rel=0.03)


def test_a_shift_down_moves_rows_down() -> None:
    image = picture(colour=False)
    out = apply_sensor(image, SensorParams(shift_y_px=2.0))
    assert np.array_equal(out[2:], image[:-2])


def test_rotation_is_about_the_centre_and_clockwise() -> None:
    image = np.zeros((101, 201), np.uint8)
    image[49:52, 189:192] = 255  # 90 px right of the centre
    out = apply_sensor(image, SensorParams(misalign_rad=0.1)).astype(float)
    row = (out.sum(axis=1) * np.arange(101)).sum() / out.sum()
    assert row == pytest.approx(50 + 90 * np.sin(0.1), abs=0.1)


@pytest.mark.parametrize("name", list(REFERENCE_DISTORTIONS))
def test_strength_zero_is_clean_and_one_is_the_reference(name: str) -> None:
    params = REFERENCE_DISTORTIONS[name]
    image = picture()
    assert np.array_equal(apply_sensor(image, scale_distortion(params, 0.0)), image)
    assert scale_distortion(params, 1.0) == params


def test_the_left_image_is_left_alone() -> None:
    views = Views(picture(), picture())
    for name in REFERENCE_DISTORTIONS:
        out = distort_right(views, name, seed=1, strength=0.5)
        assert out.left is views.left
        assert np.array_equal(out.right, views.right) == (name == "clean")


def test_there_are_ten_variants() -> None:
    assert list(REFERENCE_DISTORTIONS) == (
        ["clean", "dark", "clipped", "curve", "vignette", "local", "noise", "blur", "misrectified", "combined"]
    )


def test_bad_input_is_refused_with_the_value_and_the_remedy() -> None:
    with pytest.raises(ValueError, match="unknown distortion 'drak'; choose one of clean, dark"):
        distort_right(Views(picture(), picture()), "drak")
    with pytest.raises(ValueError, match=r"strength -1\.0 is negative"):
        scale_distortion(SensorParams(), -1.0)
    with pytest.raises(ValueError, match="float64"):
        apply_sensor(np.zeros((4, 4)), SensorParams())  # type: ignore[arg-type]
    with pytest.raises(ValidationError, match="gamma"):
        SensorParams(gamma=(0.0, 1.0, 1.0))
