"""Bad input through the command line and the API: a clear error or a finding, nothing half-written."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from expert import ExpertSystem, StereoPair
from expert.cli import main
from modules.formats import read_imu_log, write_image
from modules.simulation import TerrainParams, render_terrain
from modules.types import Attitude, Calibration

WIDTH, HEIGHT = 160, 120
TINY_CELLS = """version: 1
rules:
  - id: RIG001
    name: cells-of-a-millimetre
    stage: reconstruction
    when: [{fact: rig, field: calibrated, op: eq, value: true}]
    then:
      - {set: reconstruction.grid_elevation, parameter: cell_m, to: 0.001, score: 0.99}
    because: A grid of absurd size shall be refused.
    references: ["test"]
"""


def middlebury(focal: float = 125.0, baseline_mm: float = 90.0, cx1: float = 79.5, scale: int = 1) -> str:
    """Return a calib.txt; `scale` enlarges the image it was made for."""
    return (
        f"cam0=[{focal} 0 79.5; 0 {focal} 59.5; 0 0 1]\ncam1=[{focal} 0 {cx1}; 0 {focal} 59.5; 0 0 1]\n"
        f"doffs=0\nbaseline={baseline_mm}\nwidth={scale * WIDTH}\nheight={scale * HEIGHT}\n"
    )


@dataclass(frozen=True)
class Refused:
    """What is given, and the words of the refusal."""

    words: str
    calibration: str = middlebury()
    attitude: str = ""


REFUSED = {
    "zero baseline": Refused("the baseline is 0 m and must be above 0", middlebury(baseline_mm=0.0)),
    "negative baseline": Refused("must be above 0; swap the images if it is negative", middlebury(baseline_mm=-90.0)),
    "focal length in mm": Refused("the focal length is 3 px, .* is it in mm", middlebury(focal=3.0)),
    "doffs forgotten": Refused("doffs is 0 px and cx of cam1 minus cx of cam0 is 31.1 px", middlebury(cx1=110.6)),
    "calibration of another size": Refused("is for 320x240 px and the images are 160x120 px", middlebury(scale=2)),
    "quaternion not normalised": Refused(
        "the quaternion has length 1.02 and must have 1", attitude="quaternion: {w: 1, x: 0.2, y: 0, z: 0}\n"
    ),
    "degrees called radians": Refused("pitch_rad is 12, beyond 2 pi", attitude="pitch_rad: 12\nroll_rad: 0\n"),
    "no angle of a vehicle": Refused("pitch_deg is 100 deg, outside -90", attitude="pitch_deg: 100\nroll_deg: 0\n"),
    "gravity in g": Refused("it is in g: multiply by 9.80665", attitude="accelerometer_mps2: [0, 0, 1]\n"),
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a good pair, `left.png` and `right.png`, and one of noise, `a.png` and `b.png`."""
    made = render_terrain(TerrainParams(seed=3, width_px=WIDTH, height_px=HEIGHT, focal_px=125.0))
    path = tmp_path_factory.mktemp("pairs")
    write_image(path / "left.png", made.left)
    write_image(path / "right.png", made.right)
    rng = np.random.default_rng(0)
    for name in ("a", "b"):
        write_image(path / f"{name}.png", rng.integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8))
    return path


def stated(case: Refused, tmp_path: Path) -> tuple[Path, Path | None]:
    """Write calibration and attitude; return their paths."""
    calibration, attitude = tmp_path / "calib.txt", tmp_path / "attitude.yaml"
    calibration.write_text(case.calibration)
    if not case.attitude:
        return calibration, None
    attitude.write_text(case.attitude)
    return calibration, attitude


def terrex(monkeypatch: pytest.MonkeyPatch, *words: object) -> object:
    """Return the exit code of a command."""
    monkeypatch.setattr(sys, "argv", ["terrex", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_the_api_refuses_it_with_the_value_and_the_remedy(case: Refused, folder: Path, tmp_path: Path) -> None:
    calibration, attitude = stated(case, tmp_path)
    with pytest.raises(ValueError, match=case.words):
        StereoPair.load(folder / "left.png", folder / "right.png", calibration=calibration, attitude=attitude)


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_the_command_line_says_the_same_and_writes_nothing(
    case: Refused, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration, attitude = stated(case, tmp_path)
    more = () if attitude is None else ("--attitude", attitude)
    pair, out = (folder / "left.png", folder / "right.png"), tmp_path / "out"
    assert terrex(monkeypatch, "run", *pair, "--calibration", calibration, "--out", out, *more) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert re.search(case.words, said.err.replace("\n", " "))
    assert not out.exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"baseline_m": 0.0}, "the baseline is 0 m"),
        ({"baseline_m": -0.09}, "the baseline is -0.09 m"),
        ({"focal_px": 3.0}, "the focal length is 3 px"),
        ({"width_px": 320}, "320x120 px and the images are 160x120 px"),
    ],
)
def test_a_calibration_made_in_python_is_checked_as_well(change: dict[str, float], words: str) -> None:
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    values = {"focal_px": 125.0, "baseline_m": 0.09, "width_px": WIDTH, **change}
    camera = Calibration(values["focal_px"], 79.5, 59.5, values["baseline_m"], int(values["width_px"]), HEIGHT)
    with pytest.raises(ValueError, match=words):
        StereoPair(image, image, calibration=camera)


def test_times_out_of_order_are_refused(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "imu.csv"
    log.write_text("time_s,roll_deg,pitch_deg,yaw_deg\n0,0,0,0\n2,0,0,0\n1,0,0,0\n")
    words = "timestamps are out of order (line 4: 1.000000 s after 2.000000 s)"
    with pytest.raises(ValueError, match="out of order"):
        read_imu_log(log)
    (tmp_path / "calib.txt").write_text(middlebury())
    pair = (folder / "left.png", folder / "right.png", "--calibration", tmp_path / "calib.txt")
    assert terrex(monkeypatch, "run", *pair, "--imu", log, "--time", 0.5, "--out", tmp_path / "out") == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_points_beyond_infinity_are_a_finding(folder: Path) -> None:
    camera = Calibration(125.0, 79.5, 59.5, 0.09, WIDTH, HEIGHT, doffs_px=-6.0)
    pair = replace(StereoPair.load(folder / "left.png", folder / "right.png", attitude=Attitude()), calibration=camera)
    names = {finding.name for finding in ExpertSystem(engine="compiled").reconstruct(pair).decision.findings}
    assert "points-behind-camera" in names


def test_images_without_one_disparity_give_no_terrain_and_say_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Calibration(125.0, 79.5, 59.5, 0.09, WIDTH, HEIGHT)
    pair = replace(StereoPair.load(folder / "a.png", folder / "b.png", attitude=Attitude()), calibration=camera)
    result = ExpertSystem(engine="compiled").reconstruct(pair)
    assert result.decision.status == "failed"
    assert any(finding.severity == "critical" for finding in result.decision.findings)
    assert result.elevation is None
    assert result.points is None
    (tmp_path / "calib.txt").write_text(middlebury())
    given = (folder / "a.png", folder / "b.png", "--calibration", tmp_path / "calib.txt")
    assert terrex(monkeypatch, "run", *given, "--engine", "compiled", "--out", tmp_path / "out") == 1
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert "decision.json" in written
    assert not written & {"points.ply", "elevation.tif", "layers.npz", "terrain.html"}


def test_a_grid_of_absurd_size_is_refused_and_no_map_made(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "tiny.yaml").write_text(TINY_CELLS)
    camera = Calibration(125.0, 79.5, 59.5, 0.09, WIDTH, HEIGHT)
    pair = replace(StereoPair.load(folder / "left.png", folder / "right.png", attitude=Attitude()), calibration=camera)
    result = ExpertSystem(rules=[tmp_path / "tiny.yaml"], engine="compiled").reconstruct(pair)
    assert result.decision.status == "failed"
    assert result.elevation is None
    assert "cells of 0.001 m exceeds 4000000 cells; use cells of" in result.decision.text()
