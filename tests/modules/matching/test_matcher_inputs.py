"""What matchers say about input that cannot be matched, word by word."""

from __future__ import annotations

import numpy as np
import pytest

from modules.matching import OPERATORS
from modules.operator import OperatorError
from modules.types import DisparityRange, Matching, Views

BY_NAME = {operator.name: operator for operator in OPERATORS}
MATCHERS = [operator.name for operator in OPERATORS if operator.slot == "matcher"]
NOISE = np.random.default_rng(0).integers(0, 256, (60, 90)).astype(np.uint8)


def complaint(name: str, views: Views, low: int = 0, high: int = 16, **params: object) -> str:
    operator = BY_NAME[name]
    with pytest.raises(OperatorError) as caught:
        operator.function(Matching(views, DisparityRange(low, high)), operator.params(**params))
    return str(caught.value)


@pytest.mark.parametrize("name", MATCHERS)
def test_a_mask_of_another_shape_and_one_of_another_dtype_are_both_named(name: str) -> None:
    views = Views(NOISE, NOISE, np.ones((60, 91), bool), np.ones((60, 90), np.uint8))  # type: ignore[arg-type]
    assert complaint(name, views) == (
        f"{name}: the left mask is (60, 91) bool, the image (60, 90); give a bool mask of that shape; "
        "the right mask is (60, 90) uint8, the image (60, 90); give a bool mask of that shape"
    )


@pytest.mark.parametrize("name", MATCHERS)
def test_float_images_are_refused_with_what_to_do(name: str) -> None:
    images = NOISE.astype(np.float32) / 255
    assert complaint(name, Views(images, images)) == (  # type: ignore[arg-type]
        f"{name}: the images are float32; scale them to uint8 or uint16"
    )


@pytest.mark.parametrize("name", MATCHERS)
def test_images_of_different_shape_and_dtype_are_told_apart(name: str) -> None:
    assert complaint(name, Views(NOISE, NOISE[:, :80].astype(np.uint16))) == (
        f"{name}: left is (60, 90) uint8 and right is (60, 80) uint16; bring both to one shape and dtype first"
    )


@pytest.mark.parametrize("name", MATCHERS)
def test_an_image_smaller_than_the_window_is_refused(name: str) -> None:
    windows = {"matching.block_match": 15, "matching.semi_global_block_match": 5, "matching.semi_global_match": 9}
    small = NOISE[:4]
    assert complaint(name, Views(small, small)) == (
        f"{name}: the window of {windows[name]} px does not fit the image of 90x4 px; use a smaller window or a larger "
        "image"
    )


@pytest.mark.parametrize("name", MATCHERS)
@pytest.mark.parametrize(("low", "high"), [(0, 91), (90, 100), (-100, -89)])
def test_a_range_wider_than_the_image_or_beyond_it_is_refused(name: str, low: int, high: int) -> None:
    assert complaint(name, Views(NOISE, NOISE), low, high) == (
        f"{name}: the disparity range {low} to {high} px does not fit the image width of 90 px; use a narrower range "
        "that leaves the images some overlap"
    )


@pytest.mark.parametrize("name", MATCHERS)
def test_the_widest_range_that_fits_is_matched(name: str) -> None:
    operator = BY_NAME[name]
    for low, high in ((0, 90), (-89, 1), (-45, 45)):
        shifted = np.roll(NOISE, -4, axis=1) if high > 4 else NOISE
        found = operator.function(Matching(Views(NOISE, shifted), DisparityRange(low, high)), operator.params())
        assert found.disparity is not None
        assert found.disparity.valid.mean() > 0.5


def test_an_empty_and_an_inverted_range_are_refused() -> None:
    operator = BY_NAME["matching.use_range"]
    for low, high in ((5, 5), (9, 2)):
        with pytest.raises(OperatorError) as caught:
            operator.function(Matching(Views(NOISE, NOISE)), operator.params(min_px=low, max_px=high))
        assert str(caught.value) == (
            f"matching.use_range: max_px {high} must be larger than min_px {low}; exchange or widen them"
        )


def test_too_little_memory_is_refused_with_what_is_needed() -> None:
    wide = np.tile(NOISE, (4, 12))
    name = "matching.semi_global_match"
    assert complaint(name, Views(wide, wide), 0, 500, max_memory_mb=20) == (
        f"{name}: 1080x240 px and 500 disparities need at least 138 MB, but max_memory_mb is 20; raise it, narrow the "
        "range or reduce the images"
    )
    coarse = complaint(name, Views(wide, wide), 0, 500, max_memory_mb=20, coarse_to_fine=True)
    assert coarse.startswith(f"{name}: 540x120 px and 251 disparities need at least ")


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"window_px": 4}, "window_px 4 is even; use 5"),
        ({"p1": 20.0, "p2": 10.0}, "p2 10 is smaller than p1 20; use a larger p2"),
    ],
)
def test_parameters_that_contradict_each_other_are_refused(params: dict[str, float], words: str) -> None:
    assert (
        complaint("matching.semi_global_match", Views(NOISE, NOISE), **params) == f"matching.semi_global_match: {words}"
    )
