"""Make the picture of the README: a rendered pair, what was corrected, and the terrain that came out.

python examples/picture.py docs/images/overview.png
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from expert import ExpertSystem, StereoPair
from modules.formats.images import read_image, write_image
from modules.simulation import TerrainParams, distort_right, render_terrain
from modules.types import Views

TILE = (480, 360)  # width and height, px


def tile(image: NDArray[np.uint8], caption: str) -> NDArray[np.uint8]:
    """Scale an image into a tile with a caption above it."""
    scale = min(TILE[0] / image.shape[1], TILE[1] / image.shape[0])
    scaled = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    canvas = np.full((TILE[1] + 30, TILE[0], 3), 255, np.uint8)
    x = (TILE[0] - scaled.shape[1]) // 2
    canvas[30 : 30 + scaled.shape[0], x : x + scaled.shape[1]] = scaled
    cv2.putText(canvas, caption, (6, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.52, (30, 30, 30), 1, cv2.LINE_AA)
    return canvas


def main(target: Path) -> None:
    made = render_terrain(TerrainParams(seed=7, roll_deg=5.0, pitch_deg=-4.0))
    views = distort_right(Views(made.left, made.right), "curve", seed=7)
    pair = StereoPair(
        views.left, views.right, calibration=made.calibration, attitude=made.attitude, mount=made.mount, name="rover"
    )
    result = ExpertSystem().reconstruct(pair)
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "out"
        result.save(out)
        tiles = [
            tile(views.left, "left"),
            tile(views.right, "right: another response and a colour cast"),
            tile(result.views.right, f"right after {result.decision.operator('correction.radiometry')}"),
            tile(_rgb(read_image(out / "disparity_view.png")), "disparity"),
            tile(_rgb(read_image(out / "elevation.png")), "elevation, level frame (5 cm cells)"),
        ]
    blank = np.full_like(tiles[0], 255)
    lines = ["facts -> rules -> plan -> products", "", *(f"{s.slot}: {s.operator}" for s in result.decision.steps())]
    for number, line in enumerate(lines):
        cv2.putText(blank, line, (10, 50 + 24 * number), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (30, 30, 30), 1, cv2.LINE_AA)
    rows = [np.hstack(tiles[:3]), np.hstack([*tiles[3:], blank])]
    target.parent.mkdir(parents=True, exist_ok=True)
    write_image(target, np.vstack(rows))


def _rgb(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("overview.png"))
