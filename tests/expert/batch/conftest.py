"""Small pairs for batches, and a plug-in package whose operators misbehave."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from modules.formats import write_image

PLUGIN = '''
"""Operators that misbehave, for tests of long runs."""
import os, time
import numpy as np
from modules.operator import Cost, Operator, OperatorParams
from modules.types import Views

class MisbehaveParams(OperatorParams):
    """None."""

def misbehave(views: Views, params: MisbehaveParams) -> Views:
    """Hang, crash, eat memory or fail, as the level of the first pixel says."""
    level = int(np.ravel(views.left)[0])
    if level == 1:
        time.sleep(600)
    if level == 2:
        os._exit(7)
    if level == 3:
        np.ones(1 << 31, np.uint8)
    if level == 4:
        raise RuntimeError("a fault of the program")
    return views

OPERATOR = Operator("correction.misbehave", "defects", MisbehaveParams, misbehave, Cost(), "Misbehaves.")
'''
RULE = """version: 1
rules:
  - id: TST001
    name: always
    stage: correction
    when:
      - {fact: task}
    then:
      - {choose: correction.misbehave, score: 0.9}
    because: The pairs of this test say how it misbehaves.
    references: ["test"]
"""


def textured(seed: int, first_level: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return a pair of constant disparity; the level of the first pixel of the left image may be set."""
    draw = np.random.default_rng(seed)
    wide = cv2.resize(draw.integers(20, 235, (40, 60), np.uint8), (200, 120), interpolation=cv2.INTER_CUBIC)
    left, right = wide[:, :190].copy(), wide[:, 9:199].copy()
    if first_level is not None:
        left[0, 0] = first_level
    return left, right


def write_pair(folder: Path, name: str, seed: int, first_level: int | None = None) -> None:
    """Write `left_<name>.png` and `right_<name>.png`."""
    folder.mkdir(parents=True, exist_ok=True)
    left, right = textured(seed, first_level)
    write_image(folder / f"left_{name}.png", left)
    write_image(folder / f"right_{name}.png", right)


@pytest.fixture
def misbehaving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install the plug-in for child processes; return a rule file that chooses its operator."""
    site = tmp_path / "site"
    (site / "misbehave-1.dist-info").mkdir(parents=True)
    (site / "misbehaving.py").write_text(PLUGIN)
    (site / "misbehave-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: misbehave\nVersion: 1\n")
    (site / "misbehave-1.dist-info" / "entry_points.txt").write_text("[terrex.operators]\nx = misbehaving:OPERATOR\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(site), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]))
    (tmp_path / "rig.yaml").write_text(RULE)
    return tmp_path / "rig.yaml"
