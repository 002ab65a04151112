"""The evidence script runs on any folder of pairs with an index."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from modules.formats.images import write_image

SCRIPT = Path(__file__).parents[2] / "examples" / "evidence" / "facts.py"


@pytest.fixture
def folder(tmp_path):
    rng = np.random.default_rng(3)
    wide = np.kron(rng.integers(20, 200, (24, 40)), np.ones((4, 4))).astype(np.uint8)
    write_image(tmp_path / "left.png", wide[:, :140])
    write_image(tmp_path / "right.png", wide[:, 12:152])
    same = {"left": "left.png", "right": "right.png", "gt_disp_range": [12.0, 12.0]}
    entries = [
        {**same, "split": "dev", "radiometric_difference": False},
        {**same, "split": "terrain", "radiometric_difference": False, "gt_disp_range": None},
    ]
    (tmp_path / "INDEX.json").write_text(json.dumps(entries))
    return tmp_path


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["facts.py", *map(str, arguments)])
    runpy.run_path(str(SCRIPT), run_name="__main__")


def test_every_threshold_on_a_fact_about_pairs_is_shown_with_its_values(folder, monkeypatch, capsys):
    run(monkeypatch, "--data", folder)
    shown = capsys.readouterr().out
    block = shown.split("brightness.mean_difference_dn")[1].split("\n\n")[0]
    assert "MEA010 abs_ge" in block
    values = {line.split()[0]: float(line.split()[-3]) for line in block.splitlines()[2:]}
    assert set(values) >= {"clean", "dark", "terrain"}
    assert values["dark"] < -30.0 < values["clean"]


def test_a_folder_without_an_index_is_refused(tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit) as stopped:
        run(monkeypatch, "--data", tmp_path)
    assert stopped.value.code == 2
    assert "there is no INDEX.json in" in capsys.readouterr().err
