"""Rendered pairs, each distorted in its own way, for measurements of long runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from expert.batch import BatchItem, Settings, find_pairs
from modules.formats.calibration import write_calibration
from modules.formats.images import write_image
from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right
from modules.simulation.terrain import RenderedPair, TerrainParams, render_terrain
from modules.types import Views

SIZE = (320, 240)
FIELD = 320 / 250  # image width over focal length
STRENGTHS = (1.0, 0.5)  # of the reference distortions
QUIET = Settings(html=False)  # reports off, everything else as shipped


def rendered(seed: int, size: tuple[int, int]) -> RenderedPair:
    """Return a rendered terrain, seen from a tilted body."""
    roll, pitch = (float(angle) for angle in np.random.default_rng(seed).uniform(-10.0, 10.0, 2))
    width, height = size
    camera = {"width_px": width, "height_px": height, "focal_px": width / FIELD}
    return render_terrain(TerrainParams(seed=seed, roll_deg=roll, pitch_deg=pitch, **camera))


def pairs(count: int, size: tuple[int, int] = SIZE) -> Iterator[tuple[RenderedPair, Views]]:
    """Yield that many pairs, no two alike: terrains, each under every distortion at two strengths."""
    kinds = [(name, strength) for strength in STRENGTHS for name in REFERENCE_DISTORTIONS]
    for number in range(count):
        which = number % len(kinds)
        if which == 0:
            made = rendered(number // len(kinds), size)
        name, strength = kinds[which]
        yield made, distort_right(Views(made.left, made.right), name, number, strength)


def write_pairs(folder: Path, count: int) -> tuple[BatchItem, ...]:
    """Write pairs with their calibration into a folder, those that are not there yet; return the first `count`."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, (made, views) in enumerate(pairs(count)):
        calibration = folder / "calibration.yaml"
        if not calibration.exists():
            write_calibration(calibration, made.calibration, made.mount)
        right = folder / f"right_{number:05d}.png"
        if not right.exists():
            write_image(folder / f"left_{number:05d}.png", views.left)
            write_image(right, views.right)
    return find_pairs(folder)[:count]
