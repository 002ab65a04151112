"""Probes of sensor faults, motion blur and compression on images whose faults are known."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.measurement.compression import measure_compression
from modules.measurement.defects import measure_defects
from modules.measurement.motion import measure_motion
from modules.measurement.sample import Sample
from modules.types import Views


def scene(seed: int = 0, sigma: float = 1.2) -> NDArray[np.uint8]:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(240, 320)), (0, 0), sigma)
    return np.clip(np.rint(125 + 35 * noise / noise.std()), 0, 255).astype(np.uint8)


def test_equal_images_have_no_difference_of_faults() -> None:
    sample = Sample(Views(scene(), scene()))
    defects = measure_defects(sample)[0]
    assert defects.stuck_difference_ppm == 0
    assert defects.lines_difference == 0
    assert measure_motion(sample)[0].anisotropy == pytest.approx(1, abs=1e-6)
    assert measure_compression(sample)[0].left_blockiness < 1.1


@pytest.mark.parametrize("level", [0, 255])
def test_stuck_pixels_are_counted_in_any_channel(level) -> None:
    left = np.repeat(scene(sigma=4.0)[..., None], 3, axis=2)
    right = left.copy()
    for number in range(40):
        right[10 + 5 * number, 15 + 7 * number, number % 3] = level
    fact = measure_defects(Sample(Views(left, right)))[0]
    assert fact.left_stuck_ppm == 0
    assert fact.right_stuck_ppm == pytest.approx(40 / left[..., 0].size * 1e6, rel=0.15)


def test_bright_and_dark_lines_are_counted_in_both_directions() -> None:
    left = scene(sigma=3.0)
    right = left.astype(int)
    right[:, [50, 200]] += 40
    right[[30, 90, 150]] -= 40
    fact = measure_defects(Sample(Views(left, np.clip(right, 0, 255).astype(np.uint8))))[0]
    assert (fact.left_lines, fact.right_lines, fact.lines_difference) == (0, 5, 5)


@pytest.mark.parametrize("angle_deg", [-60, -30, 0, 30, 60, 90])
@pytest.mark.parametrize("side", ["left", "right"])
def test_the_direction_of_a_smear_is_found_in_either_image(angle_deg, side) -> None:
    sharp = scene(sigma=1.0)
    kernel = np.zeros((17, 17), np.float32)
    for step in np.linspace(-5, 5, 81):
        x, y = 8 + step * np.cos(np.deg2rad(angle_deg)), 8 + step * np.sin(np.deg2rad(angle_deg))
        kernel[round(y), round(x)] += 1
    smeared = cv2.filter2D(sharp, -1, kernel / kernel.sum())
    views = Views(smeared, sharp) if side == "left" else Views(sharp, smeared)
    fact = measure_motion(Sample(views))[0]
    assert fact.anisotropy is not None
    assert fact.direction_deg is not None
    assert fact.anisotropy < 0.6
    assert abs((fact.direction_deg - angle_deg + 90) % 180 - 90) < 8


def test_defocus_and_gain_have_no_direction() -> None:
    sharp = scene()
    for other in (cv2.GaussianBlur(sharp, (0, 0), 1.5), (0.5 * sharp + 20).astype(np.uint8)):
        anisotropy = measure_motion(Sample(Views(sharp, other)))[0].anisotropy
        assert anisotropy is not None
        assert anisotropy > 0.9


@pytest.mark.parametrize("crop", [0, 3])
def test_blocks_of_compression_show_wherever_the_grid_begins(crop) -> None:
    image = scene(sigma=2.0)
    code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 15])[1]
    packed = np.asarray(cv2.imdecode(code, cv2.IMREAD_GRAYSCALE), np.uint8)
    fact = measure_compression(Sample(Views(image[crop:, crop:], packed[crop:, crop:])))[0]
    assert fact.left_blockiness < 1.1
    assert fact.right_blockiness > 1.3
