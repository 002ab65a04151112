"""Quality of a disparity map without a reference."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.measurement.disparity_quality import PROBE, DisparityQuality
from modules.primitives.agreement import gather_evidence
from modules.primitives.confidence import predict_confidence
from modules.primitives.merit import predict_merit
from modules.types import Disparity, DisparityRange, Invalid, Matching, Views

SHIFT = 6


def pair(shift: int = SHIFT, seed: int = 3) -> Views:
    noise = np.random.default_rng(seed).normal(0, 1, (60, 200)).astype(np.float32)
    wide = cv2.GaussianBlur(noise, (0, 0), 1.2)
    wide = np.clip(128 + 45 * wide / wide.std(), 0, 255).astype(np.uint8)
    return Views(wide[:, 30:150].copy(), wide[:, 30 + shift : 150 + shift].copy())


def measure(
    disparity: NDArray[np.float64] | float, views: Views | None = None, low: int = 0, high: int = 16
) -> DisparityQuality:
    views = views or pair()
    values = np.broadcast_to(np.asarray(disparity, np.float32), views.shape).copy()
    columns = np.arange(values.shape[1]) - values
    values[(columns < 0) | (columns > values.shape[1] - 1)] = np.nan
    flags = np.where(np.isnan(values), int(Invalid.OUTSIDE), 0).astype(np.uint16)
    disparity = Disparity(values, flags)
    evidence = gather_evidence(views.left, views.right, disparity, DisparityRange(low, high))
    confidence = predict_confidence(evidence)
    known = replace(disparity, confidence=confidence, merit=predict_merit(evidence, confidence))
    (fact,) = PROBE.function(Matching(views, DisparityRange(low, high), known))
    assert isinstance(fact, DisparityQuality)
    return fact


def test_shares_of_the_true_disparity_add_up() -> None:
    fact = measure(SHIFT)
    assert fact.density_fraction == pytest.approx(1 - SHIFT / 120)
    assert fact.outside_fraction == pytest.approx(SHIFT / 120)
    assert not fact.sign_suspect


def test_a_wrong_disparity_scores_lower_than_the_true_one() -> None:
    wrong, true = measure(SHIFT + 3).score, measure(SHIFT).score
    assert wrong is not None
    assert true is not None
    assert wrong < 0.5 * true


def test_without_confidence_there_is_no_score() -> None:
    views = pair()
    disparity = Disparity(np.full(views.shape, np.float32(SHIFT)), np.zeros(views.shape, np.uint16))
    (fact,) = PROBE.function(Matching(views, DisparityRange(0, 16), disparity))
    assert isinstance(fact, DisparityQuality)
    assert (fact.score, fact.confidence_mean, fact.confidence_low_decile) == (None, None, None)
    assert fact.density_fraction == 1.0


def test_a_map_at_the_end_of_the_range_is_all_border() -> None:
    fact = measure(SHIFT, low=0, high=SHIFT + 1)
    assert fact.upper_border_fraction == fact.density_fraction
    assert fact.lower_border_fraction == 0.0


def test_rejections_are_shares_of_the_unmasked_pixels() -> None:
    views = pair()
    mask = np.zeros(views.shape, bool)
    mask[:, 60:] = True
    values = np.full(views.shape, np.float32(SHIFT))
    state = Matching(Views(views.left, views.right, mask), DisparityRange(0, 16), None)
    where = np.zeros(views.shape, bool)
    where[:30] = True
    clean = Disparity(values, np.zeros(views.shape, np.uint16))
    state = Matching(state.views, state.range_px, clean.reject(where, Invalid.LEFT_RIGHT))
    (fact,) = PROBE.function(state)
    assert isinstance(fact, DisparityQuality)
    assert fact.left_right_rejected_fraction == pytest.approx(0.5)
    assert fact.density_fraction == pytest.approx(0.5)


def test_exchanged_images_make_the_sign_suspect() -> None:
    views = pair()
    exchanged = Views(views.right, views.left)
    assert measure(np.nan, exchanged).sign_suspect
    assert not measure(np.nan, views).sign_suspect


def test_an_empty_map_scores_zero_and_no_map_gives_no_fact() -> None:
    fact = measure(np.nan)
    assert fact.score == 0.0
    assert fact.confidence_mean == 0.0
    assert PROBE.function(Matching(pair())) == []


def test_what_a_mask_excludes_counts_as_unusable_and_nothing_else() -> None:
    views = pair()
    mask = np.ones(views.shape, bool)
    mask[: views.shape[0] // 4] = False
    fact = measure(SHIFT, replace(views, left_mask=mask))
    assert fact.usable_fraction == pytest.approx(1 - (views.shape[0] // 4) / views.shape[0], abs=1e-4)
    assert fact.density_fraction == pytest.approx(1 - SHIFT / 120)
    assert measure(SHIFT).usable_fraction == 1.0
