"""What holds for every operator of correction, those added later included."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest

import modules.catalog
from modules.correction import OPERATORS, SLOTS
from modules.operator import Operator, OperatorError
from modules.types import Correspondences, Image, Views

SHIFT_PX = 8
COLOURS = pytest.mark.parametrize("channels", [1, 3], ids=["gray", "colour"])
DEPTHS = pytest.mark.parametrize("dtype", [np.uint8, np.uint16], ids=["8 bit", "16 bit"])
EVERY = pytest.mark.parametrize("operator", OPERATORS, ids=lambda operator: operator.name.split(".")[1])

# Parameters under which an operator has something to do; the others have work with their defaults.
BUSY = {"correction.align_rows": {"offset_px": 1.5, "roll_deg": 0.3}}

FITTED = {"correction.fit_response", "correction.level_gain_field", "correction.transfer_local_affine"}


@cache
def _pair(channels: int, dtype: type) -> tuple[Image, Image]:
    """Return a textured pair whose right image is darker, shifted and a little noisy."""
    random = np.random.default_rng(3)
    shape = (96, 128 + SHIFT_PX, channels)
    smooth = cv2.GaussianBlur(random.normal(size=shape).astype(np.float32), (0, 0), 2.0).reshape(shape)
    scene = np.clip(125 + 35 * smooth / smooth.std(), 8, 247)
    left, right = scene[:, :128], 0.8 * scene[:, SHIFT_PX:] + random.normal(0, 1, (96, 128, channels))
    scale = np.iinfo(dtype).max / 255
    images = [np.rint(np.clip(x, 0, 255) * scale).astype(dtype) for x in (left, right)]
    return tuple(x[..., 0] if channels == 1 else x for x in images)  # type: ignore[return-value]


def pair(channels: int, dtype: type) -> Views:
    left, right = _pair(channels, dtype)
    return Views(left.copy(), right.copy())


def run(operator: Operator, views: Views) -> Views:
    return operator.function(views, operator.params(**BUSY.get(operator.name, {})))


@EVERY
@COLOURS
@DEPTHS
def test_shape_and_dtype_are_kept_and_inputs_are_not_modified(operator, channels, dtype):
    views = pair(channels, dtype)
    mask = np.ones(views.shape, bool)
    mask[:, :20] = False
    views = Views(views.left, views.right, mask, mask.copy())
    before = [x.copy() for x in (views.left, views.right, views.left_mask, views.right_mask)]
    result = run(operator, views)
    for image in (result.left, result.right):
        assert image.shape == before[0].shape
        assert image.dtype == dtype
    for now, then in zip((views.left, views.right, views.left_mask, views.right_mask), before, strict=True):
        np.testing.assert_array_equal(now, then)


@EVERY
def test_masks_only_shrink(operator):
    views = pair(3, np.uint8)
    mask = np.ones(views.shape, bool)
    mask[30:50, 40:60] = False
    result = run(operator, Views(views.left, views.right, mask, mask.copy()))
    assert result.left_mask is not None
    assert not result.left_mask[30:50, 40:60].any()
    if operator.slot != "align":  # rows move there, and the masked region with them
        assert result.right_mask is not None
        assert not result.right_mask[30:50, 40:60].any()


@EVERY
def test_correspondences_are_kept(operator):
    views = pair(1, np.uint8)
    points = np.array([[40.0, 30.0], [90.0, 60.0]], np.float32)
    known = Correspondences(points, points - np.array([SHIFT_PX, 0], np.float32))
    result = run(operator, Views(views.left, views.right, None, None, known))
    assert result.correspondences is not None
    assert len(result.correspondences) == 2


@EVERY
@COLOURS
def test_the_same_input_gives_the_same_output(operator, channels):
    first, second = run(operator, pair(channels, np.uint8)), run(operator, pair(channels, np.uint8))
    np.testing.assert_array_equal(first.left, second.left)
    np.testing.assert_array_equal(first.right, second.right)


@EVERY
@COLOURS
@DEPTHS
def test_equal_images_stay_equal(operator, channels, dtype):
    if operator.slot == "align":
        pytest.skip("moves the right image by definition")
    image = pair(channels, dtype).left
    result = run(operator, Views(image, image.copy()))
    # Fits between corresponding points of thumbnails find gains within a hundredth of 1; the others compare exactly.
    limit = 2.0 * np.iinfo(dtype).max / 255 if operator.name in FITTED else 0
    assert np.abs(result.left.astype(int) - result.right).max() <= limit


@EVERY
def test_flipping_both_images_upside_down_flips_the_result(operator):
    if operator.slot == "align":
        pytest.skip("a roll turns the other way around")
    views = pair(3, np.uint8)
    flipped = run(operator, Views(views.left[::-1].copy(), views.right[::-1].copy()))
    straight = run(operator, views)
    for one, other in ((flipped.left, straight.left), (flipped.right, straight.right)):
        difference = np.abs(one[::-1].astype(int) - other)
        # Thinned samples start at another row, and OpenCV's CLAHE interpolates half a pixel off the middle of a tile:
        # that moves values by a level or so; a mistake of direction would move the texture of 35 dn.
        assert difference.mean() < 1.5
        assert difference.max() <= 12


@EVERY
@COLOURS
@DEPTHS
@pytest.mark.parametrize("level", [0, 100, 255])
def test_constant_images_are_refused_in_words_or_stay_constant(operator, channels, dtype, level):
    shape = (48, 64) if channels == 1 else (48, 64, channels)
    image = np.full(shape, level * (np.iinfo(dtype).max // 255), dtype)
    try:
        result = run(operator, Views(image, image.copy()))
    except OperatorError as error:
        assert operator.name in str(error)  # noqa: PT017 - either outcome is right
    else:
        for output in (result.left, result.right):
            assert len(np.unique(output)) == 1


@EVERY
@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (16, 16), (17, 31, 3)])
def test_tiny_images_are_refused_in_words_or_kept_in_shape(operator, shape):
    random = np.random.default_rng(5)
    views = Views(random.integers(0, 256, shape, np.uint8), random.integers(0, 256, shape, np.uint8))
    try:
        result = run(operator, views)
    except OperatorError as error:
        assert operator.name in str(error)  # noqa: PT017 - either outcome is right
    else:
        assert result.left.shape == result.right.shape == shape


@EVERY
def test_images_that_do_not_fit_are_refused_with_a_remedy(operator):
    views = pair(1, np.uint8)
    with pytest.raises(OperatorError, match="crop them to one size first"):
        run(operator, Views(views.left, views.right[:, :-2]))
    with pytest.raises(OperatorError, match="convert both to uint8 or both to uint16 first"):
        run(operator, Views(views.left, views.right.astype(np.uint16)))


@EVERY
def test_the_entry_is_complete(operator):
    assert operator.name.startswith("correction.")
    assert operator.slot in SLOTS
    assert operator.summary.endswith(".")
    assert operator.suits.endswith(".")
    assert operator.cost.seconds(640 * 480) > 0
    for name, field in operator.params.model_fields.items():
        assert field.description, name
        assert not field.is_required(), name


def test_the_slots_are_those_of_the_catalog():
    assert modules.catalog.SLOTS["correction"] == SLOTS
