import cv2
import numpy as np
import pytest

from modules.measurement.brightness import measure_brightness
from modules.measurement.disparity_range import measure_disparity_range
from modules.measurement.histograms import measure_histograms
from modules.measurement.image_format import measure_image_format
from modules.measurement.noise import measure_noise
from modules.measurement.radiometry import measure_radiometry
from modules.measurement.row_alignment import measure_row_alignment
from modules.measurement.sample import Sample
from modules.measurement.saturation import measure_saturation
from modules.measurement.sharpness import measure_sharpness
from modules.measurement.texture import measure_texture
from modules.types import DisparityRange, Views

SHIFT_PX = 20


def scene(width: int = 400, height: int = 240, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    layers = [
        cv2.GaussianBlur(random.normal(size=(height, width)).astype(np.float32), (0, 0), sigma)
        for sigma in (1.5, 4.0, 12.0)
    ]
    mixed = sum(layer / layer.std() for layer in layers)
    return np.clip(np.rint(125 + 18 * mixed), 0, 255).astype(np.uint8)


def pair(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    wide = scene(420, seed=seed)
    return wide[:, :400].copy(), wide[:, SHIFT_PX:].copy()


def distorted(image: np.ndarray, gain: float = 1, offset: float = 0, noise: float = 0) -> np.ndarray:
    values = gain * image + offset + np.random.default_rng(9).normal(0, noise, image.shape)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def test_an_equal_pair_differs_in_nothing() -> None:
    image = scene()
    sample = Sample(Views(image, image))
    brightness = measure_brightness(sample)[0]
    assert brightness.gain == pytest.approx(1, abs=1e-6)
    assert brightness.histogram_distance_dn == 0
    assert brightness.residual_after_monotone_map_dn == pytest.approx(0, abs=1e-3)
    assert measure_sharpness(sample)[0].ratio == 1
    assert measure_noise(sample)[0].difference_dn == 0
    assert measure_saturation(sample)[0].difference_fraction == 0


@pytest.mark.parametrize(("gain", "offset"), [(0.7, 10), (0.45, 0), (1.0, 30)])
def test_gain_and_offset_are_recovered(gain, offset) -> None:
    left, right = pair()
    fact = measure_brightness(Sample(Views(left, distorted(right, gain, offset, noise=1.5))))[0]
    assert fact.gain == pytest.approx(gain, abs=0.03)  # the columns at the sides are not quite the same
    assert fact.offset_dn == pytest.approx(offset, abs=4)


def test_radiometry_recovers_gain_from_corresponding_pixels_and_sees_local_light() -> None:
    left, right = pair()
    given = DisparityRange(0, 40)
    even = measure_radiometry(Sample(Views(left, distorted(right, 0.7)), given))[0]
    assert even.gain == pytest.approx(0.7, abs=0.02)
    lit = np.rint(right * np.linspace(0.6, 1.0, right.shape[1])).astype(np.uint8)
    uneven = measure_radiometry(Sample(Views(left, lit), given))[0]
    assert even.log_ratio_spread is not None
    assert uneven.log_ratio_spread is not None
    assert uneven.log_ratio_spread > 5 * even.log_ratio_spread


def test_a_row_offset_and_a_roll_are_recovered() -> None:
    left, right = pair()
    angle = 0.005
    height, width = right.shape
    cx, cy = (width - 1) / 2, (height - 1) / 2
    v, u = np.mgrid[0:height, 0:width].astype(np.float64)
    down = v - 1.5
    x = np.cos(angle) * (u - cx) + np.sin(angle) * (down - cy) + cx
    y = -np.sin(angle) * (u - cx) + np.cos(angle) * (down - cy) + cy
    moved = cv2.remap(right, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    fact = measure_row_alignment(Sample(Views(left, moved)))[0]
    assert fact.offset_px == pytest.approx(1.5, abs=0.05)
    assert fact.roll_deg == pytest.approx(np.rad2deg(angle), abs=0.02)
    assert fact.scale == pytest.approx(0, abs=0.0005)
    assert fact.coverage_fraction > 0.8


def test_the_estimated_range_contains_the_disparity_and_swapping_turns_its_sign() -> None:
    left, right = pair()
    fact = measure_disparity_range(Sample(Views(left, right)))[0]
    assert fact.source == "estimated"
    assert fact.min_px is not None
    assert fact.max_px is not None
    assert fact.min_px <= SHIFT_PX < fact.max_px
    assert fact.sign == "positive"
    assert measure_disparity_range(Sample(Views(right, left)))[0].sign == "negative"


def test_unrelated_images_match_hardly_anywhere() -> None:
    fact = measure_disparity_range(Sample(Views(scene(seed=1), scene(seed=2))))[0]
    assert fact.matched_fraction is not None
    assert fact.matched_fraction < 0.05
    assert fact.source == "unknown"


def test_a_given_range_is_passed_on_without_matching() -> None:
    sample = Sample(Views(scene(), scene()), DisparityRange(3, 40))
    fact = measure_disparity_range(sample)[0]
    assert (fact.min_px, fact.max_px, fact.source) == (3, 40, "given")
    assert "features" not in vars(sample)


@pytest.mark.parametrize("sigma", [4.0, 12.0])
def test_noise_is_estimated_within_a_fifth(sigma) -> None:
    smooth = cv2.GaussianBlur(scene(), (0, 0), 6)
    fact = measure_noise(Sample(Views(smooth, distorted(smooth, noise=sigma))))[0]
    assert fact.right_sigma_dn == pytest.approx(sigma, rel=0.2)
    assert fact.left_sigma_dn < 0.5


def test_blur_lowers_the_sharpness_ratio_and_gain_does_not() -> None:
    left, right = pair()
    blurred = cv2.GaussianBlur(right, (0, 0), 1.3)
    assert measure_sharpness(Sample(Views(left, blurred)))[0].ratio < 0.8
    assert measure_sharpness(Sample(Views(left, distorted(right, 0.6, 20))))[0].ratio == pytest.approx(1, abs=0.1)


def test_stripes_repeat_and_flat_images_have_no_texture() -> None:
    stripes = np.tile(np.rint(120 + 60 * np.sin(np.arange(400) / 4)).astype(np.uint8), (100, 1))
    assert measure_texture(Sample(Views(stripes, stripes)))[0].row_repetition > 0.9
    assert measure_texture(Sample(Views(scene(), scene())))[0].row_repetition < 0.6
    flat = np.full((100, 400), 90, np.uint8)
    assert measure_texture(Sample(Views(flat, flat)))[0].textureless_fraction == 1


def test_a_colour_cast_shows_in_the_channel_spread_and_a_gain_hardly() -> None:
    left, right = (np.repeat(image[..., None], 3, axis=2) for image in pair())
    cast = distorted(right)
    cast[..., 0] = distorted(right[..., 0], offset=20)
    assert measure_brightness(Sample(Views(left, cast)))[0].channel_spread_dn == pytest.approx(20, abs=2)
    assert measure_brightness(Sample(Views(left, distorted(right, 0.7))))[0].channel_spread_dn < 2


@pytest.mark.parametrize("shape", [(8, 8), (17, 23, 3), (2, 400), (64, 64)])
def test_every_probe_answers_on_tiny_flat_images_of_both_depths(shape) -> None:
    from modules import measurement

    for dtype in (np.uint8, np.uint16):
        flat = np.full(shape, 7, dtype)
        sample = Sample(Views(flat, flat))
        for probe in measurement.PROBES:
            if probe.subject == "pair":
                assert probe.function(sample)


def test_format_and_histograms_of_16_bit_colour_are_on_the_255_scale() -> None:
    image = np.full((20, 30, 3), 100 * 257, np.uint16)
    sample = Sample(Views(image, image))
    assert measure_image_format(sample)[0].bit_depth == 16
    facts = measure_histograms(sample)
    assert len(facts) == 8
    assert {fact.mean_dn for fact in facts} == {100.0}


def test_rows_that_are_far_off_are_found_by_features_over_the_whole_image() -> None:
    left, right = pair()
    moved = np.roll(right, 22, axis=0)
    sample = Sample(Views(left, moved))
    fact = measure_row_alignment(sample)[0]
    assert fact.offset_px == pytest.approx(22, abs=0.1)
    estimate = measure_disparity_range(sample)[0]
    assert estimate.min_px is not None
    assert estimate.max_px is not None
    assert estimate.min_px <= SHIFT_PX < estimate.max_px < 3 * SHIFT_PX
    assert sample.coarse is not None
    assert np.nanmedian(sample.coarse.disparity_px) / sample.coarse.factor == pytest.approx(SHIFT_PX, abs=0.5)


def test_the_moments_of_a_histogram_are_those_worked_by_hand() -> None:
    # Levels 0, 0, 0, 4: mean 1, variance 3, third moment 6, fourth 21.
    image = np.tile(np.array([[0, 4], [0, 0]], np.uint8).repeat(2, axis=0).repeat(2, axis=1), (8, 8))
    fact = measure_histograms(Sample(Views(image, image)))[0]
    assert fact.mean_dn == pytest.approx(1)
    assert fact.std_dn == pytest.approx(3**0.5)
    assert fact.skewness == pytest.approx(6 / 3**1.5)
    assert fact.bimodality == pytest.approx((36 / 27 + 1) * 9 / 21)
    two = np.where(np.arange(64) % 4 < 2, 50, 200).astype(np.uint8)[None].repeat(32, axis=0)
    assert measure_histograms(Sample(Views(two, two)))[0].bimodality == pytest.approx(1)
    ramp = np.arange(256, dtype=np.uint8)[None].repeat(32, axis=0)
    assert measure_histograms(Sample(Views(ramp, ramp)))[0].bimodality == pytest.approx(5 / 9, abs=0.01)
