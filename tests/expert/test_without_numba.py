"""The whole command where numba is not installed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from expert import Decision
from modules.formats.disparity import read_pfm
from modules.formats.images import write_image
from modules.simulation.terrain import TerrainParams, render_terrain

# An entry of None makes an import fail with ModuleNotFoundError, and a package count as not installed.
WITHOUT = "import sys; sys.modules.update(numba=None, llvmlite=None); from expert.cli import main; sys.exit(main())"
SCENE = TerrainParams(width_px=320, height_px=240, seed=2)
CALIBRATION = "focal_px: {f}\ncx_px: {x}\ncy_px: {y}\nbaseline_m: {b}\nwidth_px: 320\nheight_px: 240\n"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[subprocess.CompletedProcess[str], Path]:
    folder = tmp_path_factory.mktemp("plain")
    made = render_terrain(SCENE)
    for name, image in (("left.png", made.left), ("right.png", made.right)):
        write_image(folder / name, image)
    known = made.calibration
    text = CALIBRATION.format(f=known.focal_px, x=known.cx_px, y=known.cy_px, b=known.baseline_m)
    (folder / "calib.yaml").write_text(text, encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "-c", WITHOUT, "run", "left.png", "right.png", "--calibration", "calib.yaml", "--out", "out"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    return ended, folder / "out"


def test_a_pair_is_reconstructed_by_another_matcher_and_it_is_said(
    run: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    ended, out = run
    assert ended.returncode == 0, ended.stderr
    assert "numba is not installed, so the most accurate matcher is not available" in ended.stdout
    decision = Decision.from_json((out / "decision.json").read_text(encoding="utf-8"))
    assert decision.operator("matching.matcher") == "matching.semi_global_block_match"


def test_its_disparities_are_right_and_its_terrain_is_there(
    run: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    _, out = run
    error = np.abs(read_pfm(out / "disparity.pfm") - render_terrain(SCENE).disparity_px)
    assert np.isfinite(error).mean() > 0.5
    assert np.nanmedian(error) < 0.25  # steps of 1/16 px and a curve through three costs
    assert {"points.ply", "elevation.tif"} <= {path.name for path in out.iterdir()}
