"""Agreement of a disparity map with the images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from modules.measurement.disparity_agreement import PROBE, DisparityAgreement
from modules.types import Disparity, DisparityRange, Matching, Views

SHIFT = 6


def pair() -> Views:
    noise = np.random.default_rng(3).normal(0, 1, (60, 200)).astype(np.float32)
    wide = cv2.GaussianBlur(noise, (0, 0), 1.2)
    wide = np.clip(128 + 45 * wide / wide.std(), 0, 255).astype(np.uint8)
    return Views(wide[:, 30:150].copy(), wide[:, 30 + SHIFT : 150 + SHIFT].copy())


def measure(disparity_px: float, views: Views) -> DisparityAgreement:
    values = np.full(views.shape, np.float32(disparity_px))
    values[:, :SHIFT] = np.nan
    state = Matching(views, DisparityRange(0, 16), Disparity(values, np.isnan(values).astype(np.uint16)))
    (fact,) = PROBE.function(state)
    assert isinstance(fact, DisparityAgreement)
    return fact


def test_the_true_disparity_has_no_residual_and_full_support() -> None:
    fact = measure(SHIFT, pair())
    assert fact.photometric_residual_dn == pytest.approx(0.0, abs=0.01)
    assert fact.supported_fraction == pytest.approx(1.0, abs=0.01)
    assert fact.unsupported_step_fraction is None  # there are no steps


def test_a_wrong_disparity_is_not_supported() -> None:
    fact = measure(SHIFT + 3, pair())
    assert fact.supported_fraction is not None
    assert fact.supported_fraction < 0.3


def test_gain_and_offset_hardly_change_the_residual() -> None:
    views = pair()
    darker = Views(views.left, np.rint(views.right * 0.6 + 10).astype(np.uint8))
    residual = measure(SHIFT, darker).photometric_residual_dn
    assert residual is not None
    assert residual < 2.5


def test_an_empty_map_agrees_with_nothing_and_no_map_gives_no_fact() -> None:
    fact = measure(np.nan, pair())
    assert (fact.photometric_residual_dn, fact.supported_fraction) == (None, None)
    assert PROBE.function(Matching(pair())) == []


def test_a_patch_of_other_disparities_is_an_island() -> None:
    views = pair()
    values = np.full(views.shape, np.float32(SHIFT))
    values[20:25, 50:58] = SHIFT + 8
    state = Matching(views, DisparityRange(0, 16), Disparity(values, np.zeros(views.shape, np.uint16)))
    (fact,) = PROBE.function(state)
    assert isinstance(fact, DisparityAgreement)
    assert fact.island_fraction == pytest.approx(40 / values.size, abs=1e-4)
