"""Render a small terrain pair, for the other examples."""

from __future__ import annotations

from pathlib import Path

from modules.formats.simulation import write_rendered_pair
from modules.simulation import TerrainParams, render_terrain
from modules.types import Views


def write_small_pair(folder: Path, seed: int = 1) -> Path:
    """Write left.png, right.png, calibration.yaml, attitude.yaml and the truth into a new folder; return it."""
    params = TerrainParams(seed=seed, width_px=320, height_px=240, focal_px=250.0, roll_deg=2.0, pitch_deg=-3.0)
    made = render_terrain(params)
    write_rendered_pair(
        folder,
        Views(made.left, made.right),
        made.calibration,
        made.mount,
        made.attitude,
        made.disparity_px,
        made.occluded,
        made.elevation,
    )
    return folder
