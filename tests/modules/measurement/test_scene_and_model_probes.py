"""Facts about noise, texture, scene and fall-off on images whose answer is known."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.measurement.histogram_warp import measure_histogram_warp
from modules.measurement.noise_model import measure_noise_model
from modules.measurement.radiometry import measure_radiometry
from modules.measurement.sample import Sample
from modules.measurement.scene import measure_scene
from modules.measurement.texture_detail import measure_texture_detail
from modules.measurement.vignetting import measure_vignetting
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.simulation.terrain import TerrainParams, render_terrain
from modules.types import DisparityRange, Views

Gray = NDArray[np.uint8]


def textured(seed: int = 0, shape: tuple[int, int] = (240, 320)) -> Gray:
    random = np.random.default_rng(seed)
    layers = [cv2.GaussianBlur(random.normal(size=shape), (0, 0), sigma) for sigma in (1.5, 4.0, 12.0)]
    return np.clip(np.rint(125 + 18 * sum(layer / layer.std() for layer in layers)), 0, 255).astype(np.uint8)


def ramp(shape: tuple[int, int] = (480, 640)) -> Gray:
    return np.tile(np.linspace(20, 230, shape[1]), (shape[0], 1)).astype(np.uint8)


def both(image: Gray) -> Sample:
    return Sample(Views(image, image))


# Noise


@pytest.mark.parametrize(("electrons_per_dn", "floor_dn"), [(5.0, 2.0), (2.0, 1.0), (None, 4.0)])
def test_shot_noise_and_its_floor_are_told_apart(electrons_per_dn, floor_dn) -> None:
    params = SensorParams(noise_sigma_dn=floor_dn, electrons_per_dn=electrons_per_dn)
    noisy = np.asarray(apply_sensor(ramp(), params, seed=3), np.uint8)
    left, right = measure_noise_model(Sample(Views(ramp(), noisy)))
    assert (left.side, right.side) == ("left", "right")
    assert right.slope_dn is not None
    assert right.slope_sigma_dn is not None
    assert right.floor_dn2 is not None
    assert right.floor_sigma_dn2 is not None
    slope = 0.0 if electrons_per_dn is None else 1 / electrons_per_dn
    assert abs(right.slope_dn - slope) < 2 * right.slope_sigma_dn
    assert abs(right.floor_dn2 - floor_dn**2) < 2 * right.floor_sigma_dn2
    assert right.slope_sigma_dn < 0.15


def test_noise_at_one_level_says_nothing_of_its_slope() -> None:
    flat = np.asarray(apply_sensor(np.full((480, 640), 90, np.uint8), SensorParams(noise_sigma_dn=4.0)), np.uint8)
    assert measure_noise_model(both(flat))[0].slope_dn is None


def test_dark_texture_over_a_smooth_bright_part_is_no_noise_model() -> None:
    image = np.full((480, 640), 210, np.uint8)
    image[200:] = textured(shape=(280, 640)) // 2
    noisy = np.asarray(apply_sensor(image, SensorParams(noise_sigma_dn=2.0), seed=1), np.uint8)
    fact = measure_noise_model(both(noisy))[0]
    assert fact.slope_dn is None or fact.slope_dn > -2 * (fact.slope_sigma_dn or 0)


# Tone


def test_an_exponent_is_read_under_a_hard_shadow() -> None:
    wide = textured(shape=(240, 340))
    left, right = wide[:, :320].copy(), wide[:, 20:].copy()
    params = SensorParams(gamma=(1.4, 1.4, 1.4), spot_gain=1.6, shadow_gain=0.55)
    damaged = np.asarray(apply_sensor(right, params), np.uint8)
    lit = np.asarray(apply_sensor(right, params.model_copy(update={"gamma": (1.0, 1.0, 1.0)})), np.uint8)
    curved, even = (measure_radiometry(Sample(Views(left, x), DisparityRange(0, 40)))[0] for x in (damaged, lit))
    assert curved.local_gamma == pytest.approx(1.4, abs=0.08)
    assert even.local_gamma == pytest.approx(1.0, abs=0.04)


def test_equal_histograms_warp_at_no_cost_and_an_offset_at_little() -> None:
    image = textured()
    equal = measure_histogram_warp(both(image))[0]
    assert (equal.cost, equal.plain_cost) == (0.0, 0.0)
    brighter = np.asarray(apply_sensor(image, SensorParams(offset_dn=20.0)), np.uint8)  # five bins of the table
    fact = measure_histogram_warp(Sample(Views(image, brighter)))[0]
    assert fact.cost < 0.05 < 0.2 < fact.plain_cost


# Fall-off


@pytest.mark.parametrize("loss", [0.0, 0.3, 0.5])
def test_vignetting_of_one_image_is_read_from_that_image(loss) -> None:
    image = textured(seed=2, shape=(480, 640))
    dimmed = np.asarray(apply_sensor(image, SensorParams(vignetting=loss)), np.uint8)
    left, right = measure_vignetting(Sample(Views(image, dimmed)))
    assert left.falloff is not None
    assert right.falloff is not None
    assert right.falloff_sigma is not None
    r2 = np.linspace(0, 1, 200)
    slope = -np.polyfit(r2, np.log(1 - loss * r2), 1)[0]
    assert abs(right.falloff - left.falloff - slope) < 0.08
    assert abs(left.falloff) < 2 * right.falloff_sigma


def test_a_lighting_gradient_is_no_vignetting() -> None:
    image = textured(seed=2, shape=(480, 640)) * np.linspace(0.5, 1.0, 640)
    before = measure_vignetting(both(textured(seed=2, shape=(480, 640))))[0].falloff
    after = measure_vignetting(both(np.rint(image).astype(np.uint8)))[0].falloff
    assert before is not None
    assert after == pytest.approx(before, abs=0.06)


# Texture


def test_sixteen_levels_have_four_bits_and_one_level_has_none() -> None:
    levels = 8 + 16 * np.random.default_rng(1).integers(16, size=(120, 160))
    squares = np.kron(levels, np.ones((2, 2))).astype(np.uint8)  # halving keeps the levels
    assert measure_texture_detail(both(squares))[0].local_entropy_bits == pytest.approx(4.0, abs=0.02)
    flat = measure_texture_detail(both(np.full((240, 320), 70, np.uint8)))[0]
    assert (flat.local_entropy_bits, flat.low_entropy_fraction) == (0.0, 1.0)
    assert flat.anisotropy is None


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, -60.0, 90.0])
def test_edges_are_told_to_run_along_the_stripes(angle_deg) -> None:
    y, x = np.mgrid[:240, :320]
    across = -np.sin(np.deg2rad(angle_deg)) * x + np.cos(np.deg2rad(angle_deg)) * y
    stripes = np.rint(128 + 60 * np.sin(across / 3)).astype(np.uint8)
    fact = measure_texture_detail(both(stripes))[0]
    assert fact.anisotropy == pytest.approx(1.0, abs=0.03)
    assert fact.direction_deg is not None
    assert (fact.direction_deg - angle_deg + 90) % 180 - 90 == pytest.approx(0, abs=2)
    assert fact.row_blind_fraction == (1.0 if angle_deg == 0 else 0.0)


# Scene


def test_sky_and_horizon_of_rendered_terrain_are_found() -> None:
    made = render_terrain(TerrainParams(seed=3, pitch_deg=-6.0))
    fact = measure_scene(Sample(Views(made.left, made.right)))[0]
    rows = np.flatnonzero(~made.sky.any(axis=1))
    assert fact.sky_fraction == pytest.approx(float(made.sky.mean()), abs=0.01)
    assert fact.horizon_fraction == pytest.approx(rows[0] / len(made.sky), abs=0.03)


def test_a_shadow_and_a_featureless_patch_are_counted() -> None:
    image = textured(shape=(300, 400))
    before = measure_scene(both(image))[0]
    assert before.sky_fraction == 0
    assert before.horizon_fraction is None
    assert before.shadow_fraction < 0.02
    assert before.featureless_fraction < 0.02
    image[100:250, 100:300] = image[100:250, 100:300] // 4
    image[250:, :] = 120
    after = measure_scene(both(image))[0]
    assert after.shadow_fraction == pytest.approx(0.25, abs=0.03)
    assert after.featureless_fraction == pytest.approx(1 / 6, abs=0.02)
