"""Pairs with ground truth that benchmarks run on."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from expert import StereoPair
from expert.evaluate.scores import score
from modules.formats.datasets import DatasetPair
from modules.formats.disparity import read_pfm
from modules.formats.images import read_image
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.simulation.terrain import TerrainParams, render_terrain
from modules.types import Calibration, FloatImage

DARK = SensorParams(gain=0.45, noise_sigma_dn=1.5)
UNOCCLUDED = 255  # value of the masks of the development pairs


@dataclass(frozen=True)
class ScoredPair:
    """A pair and, where it is known, its truth: disparity in px and the pixels that are scored."""

    pair: StereoPair
    truth_px: NDArray[np.float32] | None = None
    scored: NDArray[np.bool_] | None = None
    ndisp: int = 128


def bad_1_percent(disparity_px: FloatImage, pair: DatasetPair) -> float:
    """Return the share of scored pixels that are wrong by more than 1 px, missing counted as wrong, %."""
    assert pair.truth_px is not None
    assert pair.scored is not None
    return score(disparity_px, pair.truth_px, pair.scored).bad_1


def development_pairs(folder: Path) -> Iterator[ScoredPair]:
    """Yield Motorcycle, the same with a dark and noisy right image, and the Devon Island pairs."""
    entries = json.loads((folder / "INDEX.json").read_text(encoding="utf-8"))
    for entry in entries:
        if entry["scene"] == "Motorcycle":
            yield (clean := _load(folder, entry))
            right = apply_sensor(clean.pair.right, DARK, seed=1)
            yield replace(clean, pair=replace(clean.pair, right=right, name="Motorcycle, dark"))
    for entry in entries:
        if entry["dataset"] == "devon_island":
            yield _load(folder, entry)


def rendered_pair(seed: int = 0) -> ScoredPair:
    """Return a rendered terrain, seen from a tilted body."""
    made = render_terrain(TerrainParams(seed=seed, roll_deg=5.0, pitch_deg=-8.0))
    pair = StereoPair(
        made.left,
        made.right,
        calibration=made.calibration,
        attitude=made.attitude,
        mount=made.mount,
        name=f"Rendered, seed {seed}",
    )
    return ScoredPair(pair, made.disparity_px, made.nonocc)


def _load(folder: Path, entry: dict) -> ScoredPair:
    left, right = (read_image(folder / entry[side]) for side in ("left", "right"))
    camera = None
    if entry["calib"]:
        known = json.loads((folder / entry["calib"]).read_text(encoding="utf-8"))
        camera = _calibration(known, left.shape[1], left.shape[0])
    pair = StereoPair(left, right, calibration=camera, name=entry["scene"])
    if not entry["gt"]:
        return ScoredPair(pair, ndisp=entry["ndisp"])
    mask = read_image(folder / entry["gt_mask"])
    return ScoredPair(pair, read_pfm(folder / entry["gt"]), mask == UNOCCLUDED, entry["ndisp"])


def _calibration(known: dict, width: int, height: int) -> Calibration | None:
    """Return what a development pair's calib.json says; None where a needed number is missing."""
    baseline_m = known.get("baseline_m") or known.get("baseline_mm", 0.0) / 1000.0
    if not known.get("focal_px") or not baseline_m:
        return None
    return Calibration(
        known["focal_px"],
        known.get("cx0") or (width - 1) / 2,
        known.get("cy") or (height - 1) / 2,
        baseline_m,
        width,
        height,
        known.get("doffs_px") or 0.0,
    )
