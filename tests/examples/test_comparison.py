"""What the evidence about correction counts and draws."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from modules.simulation.sensor import SensorParams
from modules.types import Views

SCRIPT = Path(__file__).parents[2] / "examples" / "evidence" / "comparison.py"


@pytest.fixture(scope="module")
def comparison() -> ModuleType:
    spec = importlib.util.spec_from_file_location("comparison", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def views() -> Views:
    image = np.random.default_rng(0).integers(40, 200, (48, 64, 3)).astype(np.uint8)
    return Views(image, image.copy())


def test_an_interval_draws_scenes_not_pairs(comparison):
    mean, low, high = comparison.interval([1.0] * 8 + [-1.0], ["a"] * 8 + ["b"])
    # Two scenes: a quarter of the draws holds only b, though it is one pair of nine.
    assert mean == pytest.approx(7 / 9)
    assert low == -1.0
    assert high == 1.0


def test_equal_differences_have_no_interval(comparison):
    assert comparison.interval([0.5, 0.5, 0.5], ["a", "b", "c"]) == (0.5, 0.5, 0.5)


def test_half_of_a_reference_distortion_is_weaker(comparison):
    plain = views()
    change = [
        np.abs(comparison.distort(plain, name, 1).right.astype(int) - plain.right).mean()
        for name in ("clean", "dark x0.5", "dark")
    ]
    assert change[0] == 0
    assert 0 < change[1] < change[2]
    same = comparison.distort(plain, SensorParams(gain=0.5), 1).right
    np.testing.assert_array_equal(same, np.rint(plain.right * 0.5).astype(np.uint8))


def test_stuck_pixels_and_lines_are_few(comparison):
    plain = views()
    changed = (comparison.distort(plain, 0.02, 1).right != plain.right).any(axis=2)
    assert changed.all(axis=0).sum() == changed.all(axis=1).sum() == 1
    assert 0.02 < changed.mean() < 0.08


def test_a_correction_that_refuses_a_pair_leaves_it(comparison):
    plain = views()
    dead = np.zeros_like(plain.left)
    dead[..., 0] = 200
    broken = Views(dead, dead.copy())
    assert comparison.correct(broken, [("correction.balance_white", {})]) is broken


def test_the_measured_alignment_brings_rows_back(comparison):
    texture = np.random.default_rng(2).integers(0, 255, (24, 40)).astype(np.float32)
    scene = np.clip(np.kron(texture, np.ones((10, 10))) * 0.7 + 20, 0, 255).astype(np.uint8)
    left, right = scene[6:-6, 10:330].copy(), scene[4:-8, 22:342].copy()  # two rows lower, 12 px of disparity
    plain = Views(left, right)
    assert comparison.alignment(plain)["offset_px"] == pytest.approx(2.0, abs=0.1)
    aligned = comparison.correct(plain, [(comparison.ALIGN, {})]).right
    before, after = (
        np.abs(left[20:-20, 32:-32].astype(int) - image[20:-20, 20:-44]).mean() for image in (right, aligned)
    )
    assert after < 0.3 * before
