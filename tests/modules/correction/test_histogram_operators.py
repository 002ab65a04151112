"""Operators that map levels: equalization, dynamic warping, matching, white balance."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from skimage.exposure import match_histograms as reference_match

from modules.correction.balance_white import BalanceWhiteParams, balance_white
from modules.correction.equalize_histogram import EqualizeHistogramParams, equalize_histogram
from modules.correction.match_histograms import MatchHistogramsParams, match_histograms
from modules.correction.warp_histograms_dynamically import (
    WarpHistogramsDynamicallyParams,
    warp_histograms_dynamically,
)
from modules.operator import OperatorError
from modules.primitives.histogram_warping import warp_levels
from modules.primitives.statistics import limit_slope
from modules.types import Views


def texture(shape: tuple[int, ...] = (120, 160), seed: int = 0, sigma_px: float = 2.0) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=shape).astype(np.float32), (0, 0), sigma_px)
    return np.rint(np.clip(120 + 40 * noise / noise.std(), 5, 250)).astype(np.uint8)


def direct_cost(a: np.ndarray, b: np.ndarray, max_run: int) -> float:
    """Evaluate the recursion of Cox, Roy and Hingorani word for word."""
    count = len(a)
    a_sums, b_sums = np.concatenate([[0], np.cumsum(a)]), np.concatenate([[0], np.cumsum(b)])
    cost = np.full((count + 1, count + 1), np.inf)
    cost[0, 0] = 0
    for m in range(1, count + 1):
        for n in range(1, count + 1):
            best = cost[m - 1, n - 1] + abs(a[m - 1] - b[n - 1])
            for k in range(2, min(max_run, m) + 1):
                best = min(best, cost[m - k, n - 1] + abs(a_sums[m] - a_sums[m - k] - b[n - 1]))
            for run in range(2, min(max_run, n) + 1):
                best = min(best, cost[m - 1, n - run] + abs(a[m - 1] - (b_sums[n] - b_sums[n - run])))
            cost[m, n] = best
    return float(cost[count, count])


@pytest.mark.parametrize("max_run", [2, 5, 16])
def test_the_warp_costs_as_little_as_the_direct_programme(max_run):
    random = np.random.default_rng(max_run)
    a, b = random.random((2, 3, 24)) ** 3
    a, b = (x / x.sum(axis=1, keepdims=True) for x in (a, b))
    costs = warp_levels(a, b, max_run).costs
    expected = [direct_cost(a[channel], b[channel], max_run) for channel in range(3)]
    np.testing.assert_allclose(costs, expected, atol=1e-5)  # float32 sums of 24 terms below 1


def test_the_warp_follows_a_known_stretch():
    # Every level of the source goes to every second level of the target: the source's levels take two each.
    source, target = np.zeros((1, 16)), np.zeros((1, 16))
    source[0, 2:8] = [1, 5, 2, 6, 3, 7]
    target[0, 4:16:2] = [1, 5, 2, 6, 3, 7]
    result = warp_levels(source, target, 16)
    np.testing.assert_allclose(result.tables[0, 2:8], np.arange(4, 16, 2))
    assert result.costs[0] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_a_warp_never_decreases(seed):
    a, b = np.random.default_rng(seed).random((2, 2, 64))
    assert (np.diff(warp_levels(a, b, 8).tables, axis=1) >= 0).all()


@pytest.mark.parametrize("channels", ["gray", "each"])
def test_warping_equal_images_changes_nothing(channels):
    image = texture((60, 80, 3))
    views = Views(image, image.copy())
    result = warp_histograms_dynamically(views, WarpHistogramsDynamicallyParams(channels=channels))
    np.testing.assert_array_equal(result.right, image)


@pytest.mark.parametrize("gamma", [0.6, 1.0, 1.5])
@pytest.mark.parametrize("operator", [warp_histograms_dynamically, match_histograms])
def test_a_known_curve_is_inverted_within_a_few_levels(gamma, operator):
    left = texture()
    right = np.rint(255 * (left / 255.0) ** gamma * 0.8).astype(np.uint8)
    params = {"warp_histograms_dynamically": WarpHistogramsDynamicallyParams, "match_histograms": MatchHistogramsParams}
    result = operator(Views(left, right), params[operator.__name__](common_view=False))
    assert np.abs(result.right.astype(int) - left).mean() < 1.5
    assert np.abs(right.astype(int) - left).mean() > 10


def test_16_bit_warps_with_1024_levels_come_closer_than_with_64():
    left = (texture().astype(np.uint16) * 257).astype(np.uint16)
    left += np.random.default_rng(1).integers(0, 257, left.shape, np.uint16)
    right = (left * 0.6 + 3000).astype(np.uint16)
    errors = []
    for levels in (64, 1024):
        params = WarpHistogramsDynamicallyParams(levels=levels, common_view=False)
        result = warp_histograms_dynamically(Views(left, right), params)
        errors.append(np.abs(result.right.astype(int) - left).mean() / 257)
    assert errors[1] < errors[0]
    assert errors[1] < 1.5  # dn; 19 pixels per level leave the histogram rough


def test_matching_agrees_with_scikit_image_within_the_step_of_its_levels():
    # scikit-image 0.22 and later match plain CDFs, this matches CDFs at the middle of each level: where levels are
    # dense, as in continuous texture of 120 x 160 px, they differ by half a level and rounding.
    left, right = texture(seed=1), (texture(seed=2) * 0.7).astype(np.uint8)
    own = match_histograms(Views(left, right), MatchHistogramsParams(common_view=False)).right
    other = reference_match(right, left)
    assert np.abs(own.astype(int) - other).mean() < 1.0


def test_a_limited_map_is_drawn_towards_the_middle():
    # Slope 1 in the middle, from level 3 on; below, 3 and 4 per level, of which 2 remain; the median keeps its place.
    table = np.array([0.0, 1, 4, 8, 9, 10, 11, 12, 13, 14, 14, 14, 14, 14, 14])
    source = np.array([0.0, 0, 1, 10, 10, 10, 10, 10, 10, 10, 0, 0, 0, 0, 0])
    limited = limit_slope(table, source, 2.0)
    np.testing.assert_allclose(limited, [2, 4, 6, 8, 9, 10, 11, 12, 13, 14, 14, 14, 14, 14, 14])


def test_noise_in_black_shadows_is_not_spread():
    random = np.random.default_rng(0)
    left = texture()
    left[:40] = random.integers(0, 12, (40, 160))  # a shadow in which the left camera still sees something
    right = np.clip(left.astype(int) - 10, 0, 255).astype(np.uint8)
    spread = [
        np.ptp(match_histograms(Views(left, right), MatchHistogramsParams(slope_limit=limit)).right[:40].astype(int))
        for limit in (1.5, 20.0)
    ]
    assert spread[0] < spread[1]


def test_equalization_follows_the_formula_of_the_paper():
    image = np.array([[10, 10, 20, 30]], np.uint8)
    result = equalize_histogram(Views(image, image.copy()), EqualizeHistogramParams())
    # cdf 0.5, 0.75, 1; max - min = 20; min = 10
    np.testing.assert_array_equal(result.left, [[20, 20, 25, 30]])


def test_equalized_images_of_two_exposures_agree():
    left = texture()
    right = np.rint(left * 0.5).astype(np.uint8)
    result = equalize_histogram(Views(left, right), EqualizeHistogramParams())
    spread = [np.interp(x, (x.min(), x.max()), (0, 1)) for x in (result.left.astype(float), result.right.astype(float))]
    assert np.abs(spread[0] - spread[1]).mean() < 0.01


def test_joint_equalization_uses_one_map_for_both():
    left, right = texture(), np.rint(texture() * 0.5).astype(np.uint8)
    result = equalize_histogram(Views(left, right), EqualizeHistogramParams(joint=True))
    level = int(np.intersect1d(left, right)[3])
    assert set(result.left[left == level]) == set(result.right[right == level])


@pytest.mark.parametrize("norm", ["mean", "power"])
def test_a_cast_is_removed_from_the_averages(norm):
    image = texture((80, 100, 3)).astype(float)
    cast = np.clip(np.rint(image * (0.8, 0.6, 0.5)), 0, 255).astype(np.uint8)
    result = balance_white(Views(cast, cast.copy()), BalanceWhiteParams(norm=norm)).left
    means = result.reshape(-1, 3).mean(axis=0)
    assert np.ptp(means) < 2.0
    assert means.mean() == pytest.approx(cast.mean(), rel=0.03)


def test_gray_images_have_no_white_to_balance():
    views = Views(texture(), texture(seed=1))
    assert balance_white(views, BalanceWhiteParams()) is views


def test_a_dead_channel_is_refused_in_words():
    image = texture((40, 50, 3))
    image[..., 2] = 0
    with pytest.raises(OperatorError, match="a channel is dead or black, use another correction"):
        balance_white(Views(image, image.copy()), BalanceWhiteParams())


def test_an_empty_mask_is_refused_in_words():
    image = texture((40, 50, 3))
    none = np.zeros((40, 50), bool)
    with pytest.raises(OperatorError, match="no pixel of the left image is unmasked; loosen the masks"):
        balance_white(Views(image, image.copy(), none, none), BalanceWhiteParams())
    with pytest.raises(OperatorError, match="no pixel of the left image is unmasked; loosen the masks"):
        equalize_histogram(Views(image, image.copy(), none, none), EqualizeHistogramParams())
