"""Shrinking, local normalisation and stuck lines: what probes and thumbnails are built on."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.primitives.noise import noise_blocks
from modules.primitives.photometry import common_view, seen_alone, shrink, standardise, standardise_to_bytes
from modules.primitives.statistics import count_levels
from modules.primitives.stuck import find_columns, stand_out

Gray = NDArray[np.uint8]


def textured(shape: tuple[int, int] = (160, 240), seed: int = 0) -> Gray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=shape), (0, 0), 1.5)
    return np.clip(np.rint(120 + 30 * noise / noise.std()), 0, 255).astype(np.uint8)


def test_halves_are_means_of_four_pixels() -> None:
    image = np.array([[0, 4, 100], [8, 12, 100], [200, 200, 200]], np.uint8)
    assert shrink(image, 1, 1).tolist() == [[6]]  # the odd row and column are cut off


@pytest.mark.parametrize("size", [(240, 160), (100, 66), (60, 40), (37, 21)])
def test_shrinking_keeps_the_mean_and_resembles_one_step(size) -> None:
    image = textured()
    small = shrink(image, *size)
    assert small.shape == (size[1], size[0])
    once = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    assert float(small.mean()) == pytest.approx(float(image.mean()), abs=1)
    difference = np.abs(small.astype(int) - once).mean()
    assert float(difference) < 0.25 * float(once.std())  # another filter, and half a pixel where a side is odd


def test_local_normalisation_undoes_gain_and_offset() -> None:
    image = textured()
    changed = np.rint(0.6 * image + 30).astype(np.uint8)
    plain, same = (standardise(x, window_px=9, damping_dn=0.01) for x in (image, changed))
    assert float(np.abs(plain - same).mean()) < 0.05  # rounding to levels
    assert float(np.abs(standardise_to_bytes(image, 9, 0.01) - 128.0 - 40 * plain).max()) < 48  # clipped beyond 3.2


def test_a_flat_image_normalises_to_zero() -> None:
    assert not standardise(np.full((20, 30), 77, np.uint8), 9, 3.0).any()


@pytest.mark.parametrize("change", [40, -40])
def test_a_bright_or_dark_column_is_found_where_it_is(change) -> None:
    image = textured().astype(int)
    image[:, [50, 60, 120]] += change
    assert find_columns(np.clip(image, 0, 255).astype(np.uint8)).tolist() == [50, 60, 120]
    assert find_columns(textured()).size == 0


def test_a_column_is_found_by_what_is_not_clipped_of_it() -> None:
    image = textured().astype(int)
    image[:, 120] += 40
    image[:100] += 200
    assert find_columns(np.clip(image, 0, 255).astype(np.uint8)).tolist() == [120]
    image[100:] += 200
    assert find_columns(np.clip(image, 0, 255).astype(np.uint8)).size == 0


def test_a_lone_pixel_stands_out_and_nothing_beside_clipped_ones_does() -> None:
    plane = np.full((5, 9), 100, np.uint8)
    plane[2, 2] = 250
    plane[2, 6] = 60
    found = stand_out(plane)
    assert found.beyond_dn[2, 2] == 150
    assert found.beyond_dn[2, 6] == 40
    assert np.count_nonzero(found.beyond_dn) == 2
    assert found.usable[2, 2]
    assert not found.usable[1, 1]
    assert found.spread_dn[1, 1] == 150


def test_noise_of_blocks_follows_the_noise() -> None:
    flat = np.random.default_rng(1).normal(100, 6, (320, 320)).round().astype(np.uint8)
    assert noise_blocks(flat).noise_dn == pytest.approx(6, rel=0.1)
    assert noise_blocks(np.zeros((20, 20), np.uint8)).noise_dn == 0


@pytest.mark.parametrize("shift_px", [-300, -30, 0, 7, 300])
def test_what_both_see_and_what_one_sees_alone_are_the_image(shift_px) -> None:
    images = textured(seed=1), textured(seed=2)
    for image, common, alone in zip(images, common_view(*images, shift_px), seen_alone(*images, shift_px), strict=True):
        assert np.array_equal(count_levels(common) + count_levels(alone), count_levels(image))
