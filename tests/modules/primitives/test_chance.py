"""How much better a pair matches than its images turned upside down."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.primitives.chance import agreement_over_chance
from modules.primitives.confidence import CERTAIN, CHANCE, chance_factor

SIZE = (180, 260)
SHIFT = 12


def blobs(seed: int, columns: int = SIZE[1], sigma_px: float = 2.0) -> NDArray[np.uint8]:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (SIZE[0], columns)), (0, 0), sigma_px)
    return np.clip(128 + 45 * noise / noise.std(), 0, 255).astype(np.uint8)


def pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    scene = blobs(1, SIZE[1] + SHIFT)
    return np.ascontiguousarray(scene[:, :-SHIFT]), np.ascontiguousarray(scene[:, SHIFT:])


def test_a_pair_of_one_scene_agrees_far_better_than_by_chance() -> None:
    found = agreement_over_chance(*pair(), 0, 48)
    assert found is not None
    assert found > 2 * CERTAIN


def test_it_does_not_depend_on_gain_and_offset() -> None:
    left, right = pair()
    darker = np.rint(0.5 * right + 20).astype(np.uint8)
    one, other = agreement_over_chance(left, right, 0, 48), agreement_over_chance(left, darker, 0, 48)
    assert one is not None
    assert other == pytest.approx(one, abs=0.1)


@pytest.mark.parametrize("sigma_px", [0.7, 2.0, 6.0])
@pytest.mark.parametrize("seed", range(4))
def test_images_of_two_scenes_agree_by_chance_only(seed: int, sigma_px: float) -> None:
    found = agreement_over_chance(blobs(seed, sigma_px=sigma_px), blobs(seed + 50, sigma_px=sigma_px), 0, 48)
    assert found is not None
    assert abs(found) < CERTAIN


def test_the_wrong_range_leaves_chance_only() -> None:
    found = agreement_over_chance(*pair(), -48, 0)
    assert found is not None
    assert abs(found) < CERTAIN


def test_an_even_pattern_and_an_empty_image_agree_no_better_than_chance() -> None:
    wave = np.broadcast_to(128 + 60 * np.sin(np.arange(SIZE[1]) / 2.0), SIZE).astype(np.uint8)
    empty = np.full(SIZE, 90, np.uint8)
    assert agreement_over_chance(wave, np.roll(wave, 5, axis=1), 0, 48) == pytest.approx(0.0, abs=1e-6)
    assert agreement_over_chance(empty, empty, 0, 48) == 0.0


def test_tiny_images_tell_nothing_and_nothing_is_concluded() -> None:
    tiny = blobs(1)[:20, :30]
    assert agreement_over_chance(tiny, tiny, 0, 16) is None
    assert chance_factor(None) == 1.0


def test_the_factor_rises_from_chance_to_certainty() -> None:
    assert chance_factor(CHANCE) == 0.0
    assert chance_factor((CHANCE + CERTAIN) / 2) == pytest.approx(0.5)
    assert chance_factor(CERTAIN) == chance_factor(1.0) == 1.0
