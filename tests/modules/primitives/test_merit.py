"""The merit of a map: what trials of one pair are ordered by."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.primitives.agreement import Evidence, gather_evidence
from modules.primitives.confidence import predict_confidence
from modules.primitives.merit import map_features, predict_merit
from modules.primitives.merit_weights import WEIGHTS
from modules.types import Disparity, DisparityRange, FloatImage

SIZE = (160, 240)
NEAR_PX, FAR_PX = 14.0, 6.0
BOX = (slice(40, 120), slice(80, 170))


def noise(seed: int, columns: int) -> NDArray[np.uint8]:
    values = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (SIZE[0], columns)), (0, 0), 1.2)
    return np.clip(90 + 25 * values / values.std(), 0, 255).astype(np.uint8)


def scene() -> tuple[NDArray[np.uint8], NDArray[np.uint8], FloatImage]:
    """Return a bright box before a dark wall, and its disparity."""
    wall, box = noise(1, SIZE[1] + 20), noise(2, SIZE[1] + 20) // 2 + 120
    left, right = wall[:, : SIZE[1]].copy(), wall[:, int(FAR_PX) : SIZE[1] + int(FAR_PX)].copy()
    left[BOX] = box[BOX]
    at = (BOX[0], slice(BOX[1].start - int(NEAR_PX), BOX[1].stop - int(NEAR_PX)))
    right[at] = box[BOX]
    truth = np.full(SIZE, np.float32(FAR_PX))
    truth[BOX] = NEAR_PX
    truth[:, : int(NEAR_PX)] = np.nan
    return left, right, truth


def judged(values: FloatImage, right: NDArray[np.uint8] | None = None) -> tuple[Evidence, FloatImage]:
    left, own, _ = scene()
    flags = np.isnan(values).astype(np.uint16)
    evidence = gather_evidence(left, own if right is None else right, Disparity(values, flags), DisparityRange(0, 32))
    return evidence, predict_confidence(evidence)


def test_the_true_map_has_the_highest_merit() -> None:
    truth = scene()[2]
    best = predict_merit(*judged(truth))
    sparse = truth.copy()
    sparse[:, ::3] = np.nan
    fattened = cv2.dilate(np.nan_to_num(truth, nan=0.0), np.ones((9, 9), np.uint8))
    fattened[np.isnan(truth)] = np.nan
    scattered = truth + np.random.default_rng(5).choice([0.0, 6.0], SIZE, p=[0.8, 0.2]).astype(np.float32)
    for name, worse in {"sparse": sparse, "fattened": fattened, "scattered": scattered, "off": truth + 3}.items():
        assert predict_merit(*judged(worse)) < best, name


def test_objects_that_end_at_edges_of_the_image_are_told_from_those_that_do_not() -> None:
    truth = scene()[2]
    moved = np.roll(truth, 8, axis=1)
    assert judged(truth)[0].edges > judged(moved)[0].edges + 1.0
    assert judged(np.full(SIZE, np.float32(FAR_PX)))[0].edges == 0.0


def test_merit_is_a_share_and_nothing_without_disparities_or_a_common_scene() -> None:
    truth = scene()[2]
    assert 0.5 < predict_merit(*judged(truth)) <= 1.0
    assert predict_merit(*judged(np.full(SIZE, np.float32(np.nan)))) == 0.0
    assert predict_merit(*judged(truth, noise(7, SIZE[1]))) == 0.0


def test_every_feature_has_a_weight_and_more_right_pixels_never_count_against_a_map() -> None:
    assert set(map_features(*judged(scene()[2]))) == set(WEIGHTS)
    assert WEIGHTS["expected"] > 0
    assert WEIGHTS["agreement"] >= 0
    assert WEIGHTS["edges"] >= 0


def test_the_weights_are_those_of_the_whole_map_as_the_benchmark_knows_it() -> None:
    evidence, confidence = judged(scene()[2])
    features = map_features(evidence, confidence)
    assert features["density"] == pytest.approx(evidence.valid.mean(), abs=1e-6)
    assert features["expected"] == pytest.approx(confidence.sum() / evidence.valid.size, rel=1e-4)
