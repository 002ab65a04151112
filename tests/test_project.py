"""The files around the code."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def motorcycle(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    import motorcycle

    yield motorcycle
    sys.modules.pop("motorcycle")


def test_the_lock_file_names_no_host_and_no_path():
    lock = (ROOT / "requirements.lock").read_text()
    assert not re.search(r"https?:|file:|--(extra-)?index-url|--find-links| @ ", lock)


def test_every_locked_requirement_has_a_hash():
    lock = (ROOT / "requirements.lock").read_text().replace("\\\n", " ")
    requirements = [line for line in lock.splitlines() if line and not line.startswith("#")]
    assert requirements
    assert [line for line in requirements if "==" not in line or "--hash=sha256:" not in line] == []


def test_a_pixel_hidden_behind_a_nearer_one_is_not_scored(motorcycle):
    truth = np.full((1, 12), 1.0, np.float32)
    truth[0, 8] = 5.0  # lands on column 3, where column 4 lands too
    visible = motorcycle.not_occluded(truth)[0]
    # Column 0 leaves the image; 3, 4 and 5 land on column 3 or one beside it.
    assert visible.tolist() == [False, True, True, False, False, False, True, True, True, True, True, True]


def test_a_pixel_without_truth_is_not_scored(motorcycle):
    truth = np.array([[np.nan, 1.0, np.nan]], np.float32)
    assert motorcycle.not_occluded(truth)[0].tolist() == [False, True, False]


def test_a_pair_that_cannot_be_downloaded_is_reported_and_leaves_nothing(motorcycle, monkeypatch, tmp_path, capsys):
    def refuse(scratch):
        raise RuntimeError("no network")

    monkeypatch.setattr(motorcycle, "_download", refuse)
    assert motorcycle.obtain_motorcycle(tmp_path) is None
    assert "cannot be had: no network" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_the_calibration_of_the_demonstration_pair_reads_back(motorcycle, tmp_path):
    from modules.formats.calibration import read_calibration

    (tmp_path / "calib.txt").write_text(motorcycle.CALIBRATION)
    found = read_calibration(tmp_path / "calib.txt")
    camera = found.rectified
    assert (camera.focal_px, camera.cx_px, camera.doffs_px, camera.width_px) == (994.978, 311.193, 31.086, 741)
    assert camera.baseline_m == pytest.approx(0.193001)
    assert found.mount is None
