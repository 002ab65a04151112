"""Checks with a reason of their own, groups of disparities, smoothing within surfaces, and the filled product."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from modules.matching.check_minimum import CheckMinimumParams, check_minimum
from modules.matching.check_range_border import CheckRangeBorderParams, check_range_border
from modules.matching.check_saturation import CheckSaturationParams, check_saturation
from modules.matching.check_texture import CheckTextureParams, check_texture
from modules.matching.cluster_disparities import ClusterDisparitiesParams, cluster_disparities, group
from modules.matching.fill_gaps import FillGapsParams, fill_gaps
from modules.matching.remove_speckles import RemoveSpecklesParams, remove_speckles
from modules.matching.smooth_along_surfaces import SmoothAlongSurfacesParams, smooth_along_surfaces
from modules.operator import OperatorError
from modules.types import Disparity, DisparityRange, Invalid, Matching, Views

NAN = float("nan")


def state_of(values: NDArray[np.float64] | list[list[float]], left: NDArray[np.uint8] | None = None) -> Matching:
    disparity = np.array(values, np.float32)
    flags = np.where(np.isnan(disparity), int(Invalid.NO_MATCH), 0).astype(np.uint16)
    image = np.full(disparity.shape, 100, np.uint8) if left is None else left
    return Matching(Views(image, image), DisparityRange(0, 16), Disparity(disparity, flags))


def result_of(state: Matching) -> Disparity:
    assert state.disparity is not None
    return state.disparity


def noise(shape: tuple[int, int], seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(60, 200, shape).astype(np.uint8)


# Ends of the range


@pytest.mark.parametrize(("ends", "kept"), [("both", [0, 1, 1, 0]), ("lower", [0, 1, 1, 1]), ("upper", [1, 1, 1, 0])])
def test_the_ends_of_the_range_are_rejected_as_asked(ends: str, kept: list[int]) -> None:
    state = state_of([[1.0, 1.1, 13.9, 14.0]])
    found = result_of(check_range_border(state, CheckRangeBorderParams(ends=ends)))  # type: ignore[arg-type]
    np.testing.assert_array_equal(found.valid, [np.array(kept, bool)])
    assert found.rejected() == {"RANGE_BORDER": 4 - sum(kept)}


def test_without_a_range_its_ends_cannot_be_checked() -> None:
    with pytest.raises(OperatorError, match=r"no disparity range is known; run matching\.use_range first"):
        check_range_border(replace(state_of([[1.0]]), range_px=None), CheckRangeBorderParams())


# Texture, saturation, minimum


def test_flat_parts_of_the_left_image_are_textureless() -> None:
    image = noise((40, 80))
    image[:, 40:] = 100
    found = result_of(check_texture(state_of(np.full((40, 80), 5.0), image), CheckTextureParams()))
    assert found.valid[:, :36].all()
    assert not found.valid[:, 46:].any()
    assert set(found.rejected()) == {"TEXTURELESS"}


def test_an_even_window_is_refused() -> None:
    with pytest.raises(OperatorError, match="window_px 4 is even; use 5"):
        check_texture(state_of([[1.0]]), CheckTextureParams(window_px=4))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_what_is_clipped_in_either_image_is_saturated(dtype: type[np.uint8] | type[np.uint16]) -> None:
    full = np.iinfo(dtype).max
    left = np.full((1, 8, 3), full // 2, dtype)
    right = left.copy()
    left[0, 6] = full  # clipped in all channels
    left[0, 7, 0] = full  # in one channel only
    right[0, 1] = full  # the match of column 3
    state = replace(state_of([[NAN, NAN, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0]]), views=Views(left, right))
    found = result_of(check_saturation(state, CheckSaturationParams()))
    np.testing.assert_array_equal(found.validity[0] == Invalid.SATURATED, [0, 0, 0, 1, 0, 0, 1, 0])


def test_a_minimum_is_flat_where_noise_hides_the_texture() -> None:
    source = np.random.default_rng(1)
    scene = np.full((60, 120), 100.0)
    scene[:, 60:] += source.normal(0, 30, (60, 60))
    left, right = (np.clip(scene + source.normal(0, 4, scene.shape), 0, 255).astype(np.uint8) for _ in range(2))
    state = replace(state_of(np.zeros((60, 120))), views=Views(left, right))
    found = result_of(check_minimum(state, CheckMinimumParams(largest_shift_px=0.2)))
    assert found.valid[:, 70:].mean() > 0.99
    assert found.valid[:, :50].mean() < 0.2
    assert set(found.rejected()) == {"FLAT_MINIMUM"}


# Groups


def grid() -> NDArray[np.float64]:
    values = np.full((8, 10), 5.0)
    values[2:4, 2:4] = 9.0  # enclosed
    values[6:8, 8:10] = 2.0  # in a corner
    values[0, 5] = NAN
    return values


def test_small_groups_are_removed_like_speckles() -> None:
    one = result_of(cluster_disparities(state_of(grid()), ClusterDisparitiesParams(max_size_px=4, small="remove")))
    other = result_of(remove_speckles(state_of(grid()), RemoveSpecklesParams(max_size_px=4)))
    np.testing.assert_array_equal(one.valid, other.valid)
    assert one.rejected() == {"NO_MATCH": 1, "SPECKLE": 8}


def test_a_small_group_gets_the_disparity_of_the_one_that_encloses_it() -> None:
    found = result_of(cluster_disparities(state_of(grid()), ClusterDisparitiesParams(max_size_px=4)))
    assert found.valid[2:4, 2:4].all()
    assert np.all(found.disparity_px[2:4, 2:4] == 5.0)
    assert np.isnan(found.disparity_px[0, 5])
    rest = np.ones((8, 10), bool)
    rest[2:4, 2:4] = rest[6:, 8:] = False
    np.testing.assert_array_equal(found.disparity_px[rest], np.float32(grid()[rest]))


def test_a_small_group_between_two_surfaces_is_removed() -> None:
    values = np.full((9, 12), 5.0)
    values[:, 6:] = 11.0
    values[4, 5:7] = 8.0
    found = result_of(cluster_disparities(state_of(values), ClusterDisparitiesParams(max_size_px=2)))
    assert found.rejected() == {"SPECKLE": 2}


@given(st.integers(0, 2**31 - 1))
def test_two_pixels_are_of_one_group_exactly_if_a_path_of_small_steps_joins_them(seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, 4, (4, 5)).astype(np.float32)
    values[values == 3] = np.nan
    labels = group(values, 1.0)
    reach = np.eye(20, dtype=bool)  # the transitive closure of small steps
    for i in range(20):
        for j in range(20):
            (a, b), (c, d) = divmod(i, 5), divmod(j, 5)
            if abs(a - c) + abs(b - d) == 1 and abs(values[a, b] - values[c, d]) <= 1.0:
                reach[i, j] = True
    for k in range(20):
        reach |= reach[:, [k]] & reach[[k], :]
    known = np.isfinite(values).ravel()
    np.testing.assert_array_equal(labels.ravel() >= 0, known)
    same = labels.ravel()[:, None] == labels.ravel()[None, :]
    np.testing.assert_array_equal(same[known][:, known], reach[known][:, known])


def test_an_empty_map_has_no_groups() -> None:
    state = state_of([[NAN, NAN]])
    assert cluster_disparities(state, ClusterDisparitiesParams()) is state


# Smoothing


def test_planes_stay_as_they_are_and_gaps_stay_empty() -> None:
    rows, columns = np.mgrid[:20, :30]
    plane = 3.0 + 0.11 * columns + 0.07 * rows
    plane[5, 5] = NAN
    found = result_of(smooth_along_surfaces(state_of(plane), SmoothAlongSurfacesParams()))
    np.testing.assert_allclose(found.disparity_px, plane, atol=2e-6)


def test_noise_shrinks_and_steps_stay() -> None:
    source = np.random.default_rng(2)
    truth = np.where(np.arange(60) < 30, 4.0, 9.0) * np.ones((40, 1))
    noisy = truth + source.normal(0, 0.1, truth.shape)
    found = result_of(smooth_along_surfaces(state_of(noisy), SmoothAlongSurfacesParams())).disparity_px
    assert np.std(found - truth) < 0.5 * np.std(noisy - truth)
    assert np.abs(found - noisy).max() <= 0.75


def test_a_different_gray_keeps_a_small_step() -> None:
    truth = np.where(np.arange(60) < 30, 4.0, 4.6) * np.ones((20, 1))
    image = np.where(np.arange(60) < 30, 60, 180).astype(np.uint8) * np.ones((20, 1), np.uint8)
    kept = result_of(smooth_along_surfaces(state_of(truth, image), SmoothAlongSurfacesParams())).disparity_px
    np.testing.assert_allclose(kept, truth, atol=1e-6)


# The filled product


def test_gaps_are_filled_from_the_farther_side_and_flagged_beside_the_measured_map() -> None:
    state = state_of([[NAN, 7.0, NAN, NAN, 3.0, 3.0, NAN]])
    made = fill_gaps(state, FillGapsParams())
    np.testing.assert_array_equal(result_of(made).disparity_px, result_of(state).disparity_px)
    assert made.filled is not None
    np.testing.assert_array_equal(made.filled.disparity_px, np.float32([[7, 7, 3, 3, 3, 3, 3]]))
    both = int(Invalid.NO_MATCH | Invalid.FILLED)
    np.testing.assert_array_equal(made.filled.validity, [[both, 0, both, both, 0, 0, both]])


def test_wide_gaps_masks_and_empty_rows_are_not_filled() -> None:
    state = state_of([[1.0, NAN, NAN, NAN, 2.0, NAN, 2.0], [NAN] * 7])
    disparity = result_of(state)
    validity = disparity.validity.copy()
    validity[0, 5] = Invalid.MASKED
    made = fill_gaps(replace(state, disparity=replace(disparity, validity=validity)), FillGapsParams(max_gap_px=2))
    assert made.filled is not None
    np.testing.assert_array_equal(made.filled.disparity_px, disparity.disparity_px)
    assert not np.any(made.filled.validity & Invalid.FILLED)


def test_filled_pixels_are_believed_by_nobody() -> None:
    state = state_of([[4.0, NAN, 4.0]])
    sure = np.float32([[0.9, 0.0, 0.9]])
    known = replace(result_of(state), confidence=sure, sigma_px=np.float32([[0.1, NAN, 0.1]]))
    made = fill_gaps(replace(state, disparity=known), FillGapsParams())
    assert made.filled is not None
    np.testing.assert_array_equal(made.filled.confidence, sure)
    assert made.filled.sigma_px is not None
    assert np.isnan(made.filled.sigma_px[0, 1])


@pytest.mark.parametrize(
    "operator",
    [
        lambda s: check_range_border(s, CheckRangeBorderParams()),
        lambda s: check_texture(s, CheckTextureParams()),
        lambda s: check_saturation(s, CheckSaturationParams()),
        lambda s: check_minimum(s, CheckMinimumParams()),
        lambda s: cluster_disparities(s, ClusterDisparitiesParams()),
        lambda s: smooth_along_surfaces(s, SmoothAlongSurfacesParams()),
        lambda s: fill_gaps(s, FillGapsParams()),
    ],
)
def test_without_a_disparity_every_one_refuses(operator) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(OperatorError, match="there is no disparity yet; run a matcher first"):
        operator(replace(state_of([[1.0]]), disparity=None))
