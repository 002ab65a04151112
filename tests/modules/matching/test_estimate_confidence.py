"""Confidence and uncertainty predicted from what any matcher leaves."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.matching.estimate_confidence import EstimateConfidenceParams, estimate_confidence
from modules.matching.semi_global_block_match import SemiGlobalBlockMatchParams, semi_global_block_match
from modules.operator import OperatorError
from modules.primitives.agreement import LAST_CODE, SCALES, UNKNOWN, gather_evidence
from modules.primitives.confidence import predict_confidence
from modules.types import Disparity, DisparityRange, FloatImage, Invalid, Matching, Views

SHIFT = 6
ROWS, COLUMNS = 120, 200
EVERYTHING = EstimateConfidenceParams(least=0.0)


def texture(seed: int, columns: int = COLUMNS, sigma_px: float = 1.2) -> NDArray[np.uint8]:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (ROWS, columns)), (0, 0), sigma_px)
    return np.clip(128 + 45 * noise / noise.std(), 0, 255).astype(np.uint8)


def views(noise_dn: float = 0.0) -> Views:
    scene = texture(3, COLUMNS + SHIFT)
    left, right = scene[:, :COLUMNS], scene[:, SHIFT:]
    if noise_dn:
        added = np.random.default_rng(9).normal(0, noise_dn, (2, *left.shape))
        left, right = (np.clip(x + n, 0, 255).astype(np.uint8) for x, n in zip((left, right), added, strict=True))
    return Views(left.copy(), right.copy())


def plane(shift: float, of: Views) -> Matching:
    values = np.full(of.shape, np.float32(shift))
    values[:, : int(np.ceil(shift))] = np.nan
    flags = np.where(np.isnan(values), int(Invalid.OUTSIDE), 0).astype(np.uint16)
    excess = np.full(of.shape, np.float32(1.0))
    return Matching(
        of, DisparityRange(0, 32), Disparity(values, flags, right_px=np.full_like(values, shift), excess=excess)
    )


def estimated(
    state: Matching, params: EstimateConfidenceParams = EVERYTHING
) -> tuple[Disparity, FloatImage, FloatImage]:
    found = estimate_confidence(state, params).disparity
    assert found is not None
    assert found.confidence is not None
    assert found.sigma_px is not None
    return found, found.confidence, found.sigma_px


def test_confidence_is_a_probability_and_sigma_positive_where_there_is_a_disparity() -> None:
    state = plane(SHIFT, views())
    found, confidence, sigma = estimated(state)
    assert confidence.dtype == sigma.dtype == np.float32
    assert np.all((confidence >= 0) & (confidence <= 1))
    np.testing.assert_array_equal(confidence > 0, found.valid)
    np.testing.assert_array_equal(np.isfinite(sigma), found.valid)
    assert np.all(sigma[found.valid] > 0)
    assert state.disparity is not None
    np.testing.assert_array_equal(found.disparity_px, state.disparity.disparity_px)


def test_the_true_disparity_is_believed_and_a_smooth_wrong_one_is_not() -> None:
    _, right, _ = estimated(plane(SHIFT, views()))
    _, wrong, _ = estimated(plane(SHIFT + 3, views()))
    assert np.median(right[:, 20:]) > 0.95
    assert np.median(wrong[:, 20:]) < 0.5


def test_gain_and_offset_hardly_change_the_confidence() -> None:
    plain = views()
    darker = Views(plain.left, np.rint(plain.right * 0.6 + 10).astype(np.uint8))
    _, one, sigma_one = estimated(plane(SHIFT, plain))
    _, other, sigma_other = estimated(plane(SHIFT, darker))
    assert np.median(np.abs(one - other)) < 0.02
    assert np.nanmedian(sigma_other / sigma_one) < 1.5


def test_what_corrections_made_of_the_images_does_not_change_the_confidence() -> None:
    plain = plane(SHIFT, views())
    flat = np.full_like(plain.views.left, 77)
    changed = replace(plain, views=plain.views.with_images(flat, flat).with_images(flat + 1, flat))
    np.testing.assert_array_equal(estimated(changed)[1], estimated(plain)[1])


def test_noise_raises_the_predicted_uncertainty() -> None:
    sigmas = [np.nanmedian(estimated(plane(SHIFT, views(noise)))[2]) for noise in (0.0, 30.0)]
    assert sigmas[1] > 1.3 * sigmas[0]


def patched() -> Matching:
    """Return a plane with a patch of random disparities, and neither excess nor right disparity."""
    state = plane(SHIFT, views())
    assert state.disparity is not None
    values = state.disparity.disparity_px.copy()
    values[40:80, 80:120] += np.random.default_rng(1).uniform(3, 20, (40, 40)).astype(np.float32)
    return replace(state, disparity=replace(state.disparity, disparity_px=values, right_px=None, excess=None))


def test_what_is_below_the_limit_is_rejected_and_keeps_what_was_predicted() -> None:
    found, confidence, sigma = estimated(patched(), EstimateConfidenceParams(least=0.95))
    rejected = (found.validity & Invalid.LOW_CONFIDENCE) != 0
    assert rejected[45:75, 85:115].mean() > 0.9
    assert rejected[:, 140:].mean() < 0.02
    assert confidence[rejected].max() < 0.95
    assert confidence[rejected].min() > 0
    assert np.isfinite(sigma[rejected]).all()
    assert np.isnan(found.disparity_px[rejected]).all()


def test_a_wrong_patch_in_a_good_map_is_believed_less_than_not() -> None:
    found, confidence, _ = estimated(patched(), EstimateConfidenceParams(least=0.5))
    rejected = (found.validity & Invalid.LOW_CONFIDENCE) != 0
    assert rejected[45:75, 85:115].mean() > 0.9
    assert rejected[:, 140:].mean() < 0.02
    assert confidence[rejected].max() < 0.5
    assert confidence[rejected].min() > 0


def test_unrelated_images_keep_hardly_a_pixel() -> None:
    unrelated = Matching(Views(texture(1), texture(2)), DisparityRange(0, 32))
    matched = semi_global_block_match(unrelated, SemiGlobalBlockMatchParams())
    assert matched.disparity is not None
    assert matched.disparity.valid.mean() > 0.3  # smoothness makes chance consistent
    found, _, _ = estimated(matched, EstimateConfidenceParams())
    assert found.valid.mean() < 0.02


def test_evidence_is_coded_within_its_scale_and_what_is_missing_is_unknown() -> None:
    state = plane(SHIFT, views())
    assert state.disparity is not None
    evidence = gather_evidence(
        state.views.left, state.views.right, replace(state.disparity, right_px=None, excess=None), state.range_px
    )
    codes = {kind: evidence.codes(kind) for kind in SCALES}
    assert all(values.shape == state.views.shape for values in codes.values())
    assert np.all(codes["left_right"] == UNKNOWN)
    assert np.all(codes["excess"] == UNKNOWN)
    inside = (slice(20, -20), slice(30, -20))
    assert np.all(codes["correlation"][inside] >= LAST_CODE - 1)
    assert np.all(codes["roughness"][inside] == 0)
    assert np.all(codes["support"][inside] == LAST_CODE)
    assert evidence.density == pytest.approx(1 - SHIFT / COLUMNS)


def test_what_is_masked_or_sky_does_not_count_as_missing() -> None:
    state = plane(SHIFT, views())
    assert state.disparity is not None
    upper = np.arange(ROWS)[:, None] < ROWS // 2
    for reason in (Invalid.MASKED, Invalid.SKY):
        part = replace(
            state.disparity,
            disparity_px=np.where(upper, np.float32(np.nan), state.disparity.disparity_px),
            validity=np.where(upper, np.uint16(reason), state.disparity.validity),
        )
        evidence = gather_evidence(state.views.left, state.views.right, part, state.range_px)
        assert evidence.density == pytest.approx(1 - SHIFT / COLUMNS)


def test_an_empty_map_is_predicted_without_warning() -> None:
    nothing = plane(SHIFT, views())
    assert nothing.disparity is not None
    nothing = replace(nothing, disparity=nothing.disparity.reject(np.ones(nothing.views.shape, bool), Invalid.NO_MATCH))
    assert nothing.disparity is not None
    evidence = gather_evidence(nothing.views.left, nothing.views.right, nothing.disparity, nothing.range_px)
    assert predict_confidence(evidence).max() == 0.0


def test_without_a_disparity_it_refuses() -> None:
    with pytest.raises(OperatorError, match=r"matching\.estimate_confidence: there is no disparity yet"):
        estimate_confidence(Matching(views()), EVERYTHING)
