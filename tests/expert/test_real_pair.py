"""The main job on a real pair with ground truth: Motorcycle of Middlebury 2014 at quarter size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from expert import ExpertSystem, Result, StereoPair
from expert.report import as_summary
from modules.formats.disparity import read_pfm
from modules.formats.images import read_image
from modules.simulation.sensor import SensorParams, apply_sensor

pytestmark = pytest.mark.data
UNOCCLUDED = 255
DARK = SensorParams(gain=0.45, noise_sigma_dn=1.5)


def bad_2_percent(result: Result, folder: Path) -> float:
    """Return the share of visible pixels that are missing or wrong by more than 2 px."""
    scored = read_image(folder / "mask0nocc.png") == UNOCCLUDED
    good = np.abs(result.disparity_px - read_pfm(folder / "gt.pfm")) <= 2.0
    return float(100.0 * (1.0 - good[scored].mean()))


@pytest.fixture(scope="module")
def folder(development_data: Path) -> Path:
    return development_data / "middlebury_v3_trainQ" / "Motorcycle"


@pytest.fixture(scope="module")
def pair(folder: Path) -> StereoPair:
    return StereoPair.load(folder / "left.png", folder / "right.png", calibration=folder / "calib.txt")


@pytest.fixture(scope="module")
def clean(pair: StereoPair) -> Result:
    return ExpertSystem().reconstruct(pair)


@pytest.fixture(scope="module")
def dark(pair: StereoPair) -> Result:
    right = apply_sensor(pair.right, DARK, seed=1)
    return ExpertSystem().reconstruct(StereoPair(pair.left, right, calibration=pair.calibration))


def test_the_pair_as_it_is_has_few_wrong_pixels(clean: Result, folder: Path) -> None:
    assert clean.decision.status == "reconstructed"
    assert bad_2_percent(clean, folder) <= 6.3


def test_a_dark_and_noisy_right_image_costs_little(dark: Result, folder: Path) -> None:
    assert dark.decision.status == "reconstructed"
    assert bad_2_percent(dark, folder) <= 7.2


def test_the_two_are_decided_differently_and_the_report_says_why(clean: Result, dark: Result) -> None:
    assert clean.decision.operator("correction.radiometry") == "none"
    assert dark.decision.operator("correction.radiometry") == "correction.match_histograms"
    assert "exposure-differs" not in [finding.name for finding in clean.decision.findings]
    assert "exposure-differs" in [finding.name for finding in dark.decision.findings]
    assert "the two images differ in exposure" in dark.decision.text()
    assert "correction.match_histograms" in as_summary(dark.decision)
    assert "correction.match_histograms" not in as_summary(clean.decision)


def test_the_swapped_pair_is_known_and_not_reconstructed(pair: StereoPair) -> None:
    decision = ExpertSystem(engine="compiled").reconstruct(StereoPair(pair.right, pair.left)).decision
    assert decision.status == "failed"
    assert "images-swapped" in [finding.name for finding in decision.findings]


def test_the_left_image_with_another_scene_is_not_reconstructed(pair: StereoPair, development_data: Path) -> None:
    other = read_image(development_data / "middlebury_v3_trainQ" / "Pipes" / "right.png")
    rows, columns = (min(a, b) for a, b in zip(pair.left.shape[:2], other.shape[:2], strict=True))
    unrelated = StereoPair(pair.left[:rows, :columns], other[:rows, :columns])
    decision = ExpertSystem(engine="compiled").reconstruct(unrelated).decision
    assert decision.status == "failed"
