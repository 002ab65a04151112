import cv2
import numpy as np
import pytest

from modules.correction.align_rows import AlignRowsParams, align_rows
from modules.correction.fit_gain_offset import FitGainOffsetParams, fit_gain_offset
from modules.correction.mask_saturated import MaskSaturatedParams, mask_saturated
from modules.correction.mask_sky import MaskSkyParams, mask_sky
from modules.correction.match_histograms import MatchHistogramsParams, match_histograms
from modules.correction.normalise_local_contrast import NormaliseLocalContrastParams, normalise_local_contrast
from modules.operator import OperatorError
from modules.types import Views


def texture(shape: tuple[int, ...] = (120, 160), dtype: str = "uint8", seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    scaled = np.clip(120 + 40 * smooth / smooth.std(), 5, 250)
    return np.rint(scaled * (np.iinfo(dtype).max / 255)).astype(dtype)


@pytest.mark.parametrize("reference", ["left", "right", "midway"])
@pytest.mark.parametrize("channels", ["gray", "each"])
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_matching_equal_images_changes_nothing(reference, channels, dtype) -> None:
    image = texture((60, 80, 3), dtype)
    result = match_histograms(Views(image, image), MatchHistogramsParams(reference=reference, channels=channels))
    np.testing.assert_array_equal(result.left, image)
    np.testing.assert_array_equal(result.right, image)


def test_a_known_monotone_map_is_inverted_within_the_levels_it_merged() -> None:
    left = texture()
    right = np.rint(255 * (left / 255.0) ** 1.5 * 0.8).astype(np.uint8)
    result = match_histograms(Views(left, right), MatchHistogramsParams(common_view=False))
    # The slope is at least 0.17 at level 5 and about 0.8 in the middle: merged levels differ by 3 where content is.
    assert np.abs(result.right.astype(int) - left).max() <= 4
    assert np.abs(result.right.astype(int) - left).mean() < 0.5


def test_midway_brings_both_images_to_the_mean_of_the_quantiles() -> None:
    left = np.full((40, 40), 100, np.uint8)
    right = np.full((40, 40), 50, np.uint8)
    result = match_histograms(Views(left, right), MatchHistogramsParams(reference="midway"))
    assert set(np.unique(result.left)) == set(np.unique(result.right)) == {75}


@pytest.mark.parametrize(("gain", "offset"), [(0.7, 12), (0.45, 0), (1.0, 30)])
def test_a_gain_and_an_offset_are_undone_within_rounding(gain, offset) -> None:
    left = texture((120, 160, 3))
    right = np.clip(np.rint(gain * left + offset), 0, 255).astype(np.uint8)
    result = fit_gain_offset(Views(left, right), FitGainOffsetParams())
    use = right < 255
    # Rounding to whole levels of the darkened image costs half a level over the gain, the final rounding another half.
    assert np.abs(result.right.astype(int) - left)[use].max() <= 0.5 / gain + 0.5 + 1


def test_zero_alignment_returns_the_same_views() -> None:
    views = Views(texture(), texture(seed=1))
    assert align_rows(views, AlignRowsParams()) is views


def test_a_whole_row_offset_is_undone_exactly() -> None:
    image = texture()
    shifted = np.roll(image, 3, axis=0)
    result = align_rows(Views(image, shifted), AlignRowsParams(offset_px=3))
    assert result.right_mask is not None
    np.testing.assert_array_equal(result.right[result.right_mask], image[result.right_mask])
    assert not result.right_mask[-3:].any()
    assert result.right_mask[:-3].all()
    assert result.left is image


def test_a_roll_is_undone_as_a_rotation() -> None:
    image = texture()
    height, width = image.shape
    angle = np.deg2rad(1.0)
    cx, cy = (width - 1) / 2, (height - 1) / 2
    v, u = np.mgrid[0:height, 0:width].astype(np.float64)
    # Content at (u, v) of the straight image lands at R (u, v): the rotated image reads the straight one at R^-1.
    x = np.cos(angle) * (u - cx) + np.sin(angle) * (v - cy) + cx
    y = -np.sin(angle) * (u - cx) + np.cos(angle) * (v - cy) + cy
    rolled = cv2.remap(image, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC)
    result = align_rows(Views(image, rolled), AlignRowsParams(roll_deg=1.0))
    inner = (slice(10, -10), slice(10, -10))
    difference = np.abs(result.right[inner].astype(int) - image[inner])
    assert difference.mean() < 1.0  # two cubic interpolations and two roundings of texture of 40 dn
    untouched = np.abs(rolled[inner].astype(int) - image[inner])
    assert difference.mean() < 0.2 * untouched.mean()


def test_local_normalisation_does_not_see_gain_and_offset() -> None:
    left = texture((80, 100), "uint16")
    right = (left // 2 + 5000).astype(np.uint16)
    result = normalise_local_contrast(Views(left, right), NormaliseLocalContrastParams(eps_dn=0.1))
    # eps weighs 0.1 dn against a local deviation of 20-40 dn, of 10-20 dn after the gain.
    assert np.abs(result.left.astype(int) - result.right).mean() < 0.005 * 65535


def test_clipped_pixels_are_masked_in_each_image() -> None:
    left, right = np.full((20, 20), 100, np.uint8), np.full((20, 20), 100, np.uint8)
    left[5, 5], right[10, 10] = 255, 0
    result = mask_saturated(Views(left, right), MaskSaturatedParams(margin_px=1))
    assert result.left_mask is not None
    assert result.right_mask is not None
    assert np.count_nonzero(~result.left_mask) == np.count_nonzero(~result.right_mask) == 9


def test_a_bright_smooth_top_is_sky_and_textured_ground_is_not() -> None:
    image = texture((200, 300)) // 2
    image[:60] = 220
    usable = mask_sky(Views(image, image), MaskSkyParams()).left_mask
    assert usable is not None
    assert not usable[:56].any()
    assert usable[64:].all()
    ground = texture((200, 300))
    usable = mask_sky(Views(ground, ground), MaskSkyParams()).left_mask
    assert usable is not None
    assert usable.all()


def test_images_of_different_size_are_refused_in_words() -> None:
    with pytest.raises(OperatorError, match="crop them to one size first"):
        match_histograms(Views(texture((20, 20)), texture((20, 22))), MatchHistogramsParams())
