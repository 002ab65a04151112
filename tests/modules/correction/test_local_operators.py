"""Operators that look at the neighbourhood of a pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import ndimage

from modules.correction._shared import rescale_jointly
from modules.correction.denoise_bilateral import DenoiseBilateralParams, denoise_bilateral
from modules.correction.denoise_non_local_means import DenoiseNonLocalMeansParams, denoise_non_local_means
from modules.correction.equalize_adaptively import EqualizeAdaptivelyParams, equalize_adaptively
from modules.correction.filter_homomorphic import FilterHomomorphicParams, filter_homomorphic
from modules.correction.filter_laplacian import FilterLaplacianParams, filter_laplacian
from modules.correction.mask_featureless import MaskFeaturelessParams, mask_featureless
from modules.correction.normalise_local_contrast import NormaliseLocalContrastParams, normalise_local_contrast
from modules.correction.rank_locally import RankLocallyParams, rank_locally
from modules.correction.repair_stuck_pixels import RepairStuckPixelsParams, repair_stuck_pixels
from modules.correction.subtract_bilateral_background import (
    SubtractBilateralBackgroundParams,
    subtract_bilateral_background,
)
from modules.operator import OperatorError
from modules.primitives.photometry import smooth
from modules.types import Views


def texture(shape: tuple[int, ...] = (96, 128), seed: int = 0, sigma_px: float = 2.0) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=shape).astype(np.float32), (0, 0), sigma_px)
    return np.rint(np.clip(120 + 25 * noise / noise.std(), 40, 200)).astype(np.uint8)


def vignetted(image: np.ndarray, loss: float = 0.5) -> np.ndarray:
    rows, columns = image.shape
    y, x = np.mgrid[:rows, :columns].astype(float)
    radius = ((x - columns / 2) ** 2 + (y - rows / 2) ** 2) / (columns**2 / 4 + rows**2 / 4)
    return np.rint(image * (1 - loss * radius)).astype(np.uint8)


def difference(first: np.ndarray, second: np.ndarray) -> float:
    """Return the difference of two images relative to their contrast."""
    return float(np.abs(first.astype(float) - second).mean() / np.std(first.astype(float)))


@pytest.mark.parametrize(
    ("operator", "params"),
    [
        (filter_homomorphic, FilterHomomorphicParams(cutoff=4)),
        (normalise_local_contrast, NormaliseLocalContrastParams(sigma_px=8)),
        (rank_locally, RankLocallyParams()),
        (filter_laplacian, FilterLaplacianParams()),
        (subtract_bilateral_background, SubtractBilateralBackgroundParams()),
    ],
)
def test_vignetting_differs_less_after_than_before(operator, params):
    left = texture()
    right = vignetted(left)
    result = operator(Views(left, right), params)
    assert difference(result.left, result.right) < 0.75 * difference(left, right)


@pytest.mark.parametrize("kind", ["gaussian", "butterworth"])
def test_the_homomorphic_filter_agrees_with_the_formula(kind):
    image = texture((64, 64))
    params = FilterHomomorphicParams(kind=kind, cutoff=6, order=2, sharpness=1.5)
    own = filter_homomorphic(Views(image, image.copy()), params).left.astype(float)
    padded = np.pad(np.log1p(image.astype(float)), 64, mode="reflect")
    rows, columns = np.meshgrid(*(np.fft.fftfreq(192) * 64,) * 2, indexing="ij")
    squared = (rows**2 + columns**2) / 6**2
    high = 1 - np.exp(-1.5 * squared) if kind == "gaussian" else 1 - 1 / (1 + 0.414 * squared**2)
    plain = np.expm1(np.real(np.fft.ifft2(np.fft.fft2(padded) * (0.5 + 1.5 * high))))[64:128, 64:128]
    inner = (slice(8, -8), slice(8, -8))
    # The own filter rescales linearly and pads less, so only the shape is compared.
    assert np.corrcoef(own[inner].ravel(), plain[inner].ravel())[0, 1] > 0.995


def test_homomorphic_images_share_one_range():
    left = texture()
    right = np.rint(left * 0.5).astype(np.uint8)
    result = filter_homomorphic(Views(left, right), FilterHomomorphicParams(low_gain=1.0, high_gain=1.0))
    # With equal gains nothing is filtered: had each image been stretched by itself, they would now be equal.
    ratio = (result.right.astype(float) - result.right.min()).mean() / (result.left.astype(float)).mean()
    assert ratio < 0.7


def test_nothing_left_after_filtering_is_an_error_in_words():
    flat = np.full((40, 50), 90, np.uint8)
    with pytest.raises(OperatorError, match="two are needed; a constant image cannot be corrected"):
        filter_homomorphic(Views(flat, flat.copy()), FilterHomomorphicParams())


def test_values_that_vary_by_rounding_alone_are_constant():
    flat = np.full((40, 50), 90, np.uint8)
    rounded = np.full((40, 50), 8.53939, np.float32)
    rounded[:, ::2] += np.float32(8e-6)
    with pytest.raises(OperatorError, match="two are needed"):
        rescale_jointly(rounded, rounded, flat, "correction.filter_homomorphic")


def test_the_laplacian_agrees_with_scipy():
    image = texture()
    own = filter_laplacian(Views(image, image.copy()), FilterLaplacianParams(sigma_px=2.0, gain=4.0)).left
    reference = 127.5 - 4.0 * 4.0 * ndimage.gaussian_laplace(image.astype(float), 2.0, mode="mirror")
    inner = (slice(10, -10), slice(10, -10))
    # Differences of neighbours stand for derivatives: 4 % of a response of up to 127 dn at this scale.
    error = np.abs(own[inner] - np.clip(reference, 0, 255)[inner])
    assert error.mean() < 0.05 * np.std(reference)


@pytest.mark.parametrize("offset", [-20, 35])
def test_the_laplacian_does_not_see_an_offset(offset):
    left = texture()
    result = filter_laplacian(Views(left, (left.astype(int) + offset).astype(np.uint8)), FilterLaplacianParams())
    assert np.abs(result.left.astype(int) - result.right).max() <= 1


@pytest.mark.parametrize("radius", [1, 4])
def test_ranks_agree_with_a_direct_count(radius):
    image = texture((30, 40), sigma_px=0.8) // 8 * 8  # coarse levels, so that there are ties
    own = rank_locally(Views(image, image.copy()), RankLocallyParams(radius_px=radius)).left
    side = 2 * radius + 1
    padded = np.pad(image.astype(int), radius, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side)).reshape(*image.shape, -1)
    centre = image[..., None].astype(int)
    rank = (windows < centre).sum(axis=-1) + ((windows == centre).sum(axis=-1) - 1) / 2
    np.testing.assert_allclose(own, rank * 255 / (side * side - 1), atol=0.5001)


def test_ranks_do_not_see_an_increasing_map():
    left = texture()
    right = (left // 2 + 60).astype(np.uint8)
    wide = Views(left // 2 * 2, (left // 2 * 2 // 2 + 60).astype(np.uint8))
    assert wide.right.shape == right.shape
    result = rank_locally(wide, RankLocallyParams())
    np.testing.assert_array_equal(result.left, result.right)


def test_the_adaptive_equalization_is_that_of_opencv():
    image = texture()
    own = equalize_adaptively(Views(image, image.copy()), EqualizeAdaptivelyParams(clip_limit=3.0, tiles=4)).left
    np.testing.assert_array_equal(own, cv2.createCLAHE(3.0, (4, 4)).apply(image))


@pytest.mark.parametrize(
    ("operator", "params"),
    [
        (denoise_bilateral, DenoiseBilateralParams(sigma_dn=40)),
        (denoise_non_local_means, DenoiseNonLocalMeansParams(strength_dn=15)),
    ],
)
@pytest.mark.parametrize("scale", [1, 257])
def test_noise_on_two_plateaus_is_halved_and_their_edge_stays(operator, params, scale):
    scene = np.where(np.arange(100) < 50, 60.0, 180.0)[None, :].repeat(80, axis=0)
    noisy = np.clip(scene + np.random.default_rng(0).normal(0, 10, scene.shape), 0, 255)
    image = np.rint(noisy * scale).astype(np.uint8 if scale == 1 else np.uint16)
    result = operator(Views(image, image.copy()), params).left / scale
    assert np.std(result[:, :40]) < 5
    assert result[:, 45:49].mean() < 75
    assert result[:, 51:55].mean() > 165


@pytest.mark.parametrize("level", [0, 255])
def test_stuck_pixels_are_replaced_and_nothing_else(level):
    image = texture()
    broken = image.copy()
    places = ([10, 40, 70], [20, 64, 100])
    broken[places] = level
    result = repair_stuck_pixels(Views(broken, image), RepairStuckPixelsParams()).left
    assert np.abs(result[places].astype(int) - image[places]).max() < 25
    rest = np.ones(image.shape, bool)
    rest[places] = False
    np.testing.assert_array_equal(result[rest], image[rest])


@pytest.mark.parametrize("axis", [0, 1])
def test_a_stuck_line_is_replaced(axis):
    image = texture()
    broken = image.copy()
    index = (slice(None), 50) if axis else (50, slice(None))
    broken[index] = 255
    result = repair_stuck_pixels(Views(broken, image), RepairStuckPixelsParams()).left
    assert np.abs(result[index].astype(int) - image[index]).mean() < 8
    untouched = repair_stuck_pixels(Views(broken, image), RepairStuckPixelsParams(lines=False)).left
    assert (untouched[index] == 255).all()


def test_sound_images_stay_as_they_are():
    image = texture((96, 128, 3))
    result = repair_stuck_pixels(Views(image, image.copy()), RepairStuckPixelsParams())
    np.testing.assert_array_equal(result.left, image)


def test_smooth_ground_is_masked_and_texture_is_not():
    image = texture()
    image[:, :60] = 100
    usable = mask_featureless(Views(image, image.copy()), MaskFeaturelessParams(radius_px=5)).left_mask
    assert usable is not None
    assert not usable[:, :54].any()
    assert usable[:, 66:].all()


@pytest.mark.parametrize("sigma", [8.0, 20.0, 40.0])
def test_the_reduced_smoothing_agrees_with_the_full_one(sigma):
    values = texture((240, 320), sigma_px=3.0).astype(np.float32)
    error = np.abs(smooth(values, sigma) - cv2.GaussianBlur(values, (0, 0), sigma))
    assert error.mean() < 0.01 * values.std() * 3
    assert error.max() < 0.1 * values.std() * 3
