"""A rendered sequence from the command line to one map."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from expert import ExpertSystem, StereoPair
from expert.cli import main
from expert.sequence import View, fuse
from modules.formats import read_layers
from modules.formats.simulation import write_rendered_pair
from modules.simulation import TerrainParams, render_terrain
from modules.types import Pose, Views

HEAD = "name,time_s,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg\n"


def run(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["terrex", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    """Three views of one terrain from one place, by three attitudes; returns folders, poses and the first pair."""
    folder, lines, made = tmp_path_factory.mktemp("sequence"), [], []
    for k, (roll, pitch) in enumerate(((0.0, -4.0), (3.0, 2.0), (-4.0, 6.0))):
        params = TerrainParams(
            seed=8, width_px=320, height_px=240, focal_px=250.0, supersample=1, roll_deg=roll, pitch_deg=pitch
        )
        made.append(render_terrain(params))
        one = made[-1]
        views = Views(one.left, one.right)
        write_rendered_pair(
            folder / f"view{k}",
            views,
            one.calibration,
            one.mount,
            one.attitude,
            one.disparity_px,
            one.occluded,
            one.elevation,
        )
        lines.append(f"view{k},{k},0,0,0,{roll},{pitch},0")
    (folder / "poses.csv").write_text(HEAD + "\n".join(lines) + "\n")
    return folder, made[0]


def test_a_sequence_becomes_one_map_that_agrees_with_the_terrain(sequence, tmp_path, monkeypatch, capsys):
    folder, made = sequence
    views = [folder / f"view{k}" for k in range(3)]
    assert run(monkeypatch, "fuse", *views, "--poses", folder / "poses.csv", "--out", tmp_path / "map") == 0
    assert "3 of 3 views fused" in capsys.readouterr().out
    grid = read_layers(tmp_path / "map" / "layers.npz")
    i, j = np.nonzero((grid.layers["views"] >= 2) & np.isfinite(grid.layers["elevation"]))
    x, y = grid.x0_m + (j + 0.5) * grid.cell_m, grid.y0_m + (i + 0.5) * grid.cell_m
    near = np.hypot(x, y) < 5.0
    error = grid.layers["elevation"][i, j] - made.height_m(x, y)
    assert near.sum() > 500
    assert np.median(np.abs(error[near])) < 0.03
    assert grid.layers["moving"][i, j][near].mean() < 0.1
    assert {"elevation.tif", "elevation.png", "traversability.png", "decisions"} <= {
        path.name for path in (tmp_path / "map").iterdir()
    }
    first = json.loads((tmp_path / "map" / "decisions" / "0000.json").read_text())
    assert "plans" in str(first.keys())


def test_a_last_view_without_content_leaves_the_map_its_slopes(sequence):
    folder, _ = sequence
    pairs = [StereoPair.load(folder / f"view{k}/left.png", folder / f"view{k}/right.png",
                             calibration=folder / f"view{k}/calibration.yaml") for k in (0, 1)]  # fmt: skip
    black = np.zeros_like(pairs[1].left)
    views = [View(pairs[0], Pose(), 0.0), View(replace(pairs[1], left=black, right=black), Pose(), 1.0)]
    alone, both = (fuse(ExpertSystem(engine="compiled"), views[:count], cell_m=0.1) for count in (1, 2))
    assert len(both.skipped) == 1
    assert set(both.elevation.layers) == set(alone.elevation.layers)
    assert "slope_deg" in both.elevation.layers


def test_two_folders_of_one_name_are_refused(sequence, tmp_path, monkeypatch, capsys):
    folder, _ = sequence
    other = tmp_path / "view0"
    other.mkdir()
    assert (
        run(monkeypatch, "fuse", folder / "view0", other, "--poses", folder / "poses.csv", "--out", tmp_path / "map")
        == 2
    )
    assert "two folders have one name" in capsys.readouterr().err


def test_a_folder_without_a_pose_is_refused_before_any_work(sequence, tmp_path, monkeypatch, capsys):
    folder, _ = sequence
    (tmp_path / "poses.csv").write_text(HEAD + "other,0,0,0,0,0,0,0\n")
    code = run(monkeypatch, "fuse", folder / "view0", "--poses", tmp_path / "poses.csv", "--out", tmp_path / "map")
    assert code == 2
    assert "has no pose for view0; add a line for each folder" in capsys.readouterr().err
    assert not (tmp_path / "map").exists()
