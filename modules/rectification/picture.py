"""A picture of a calibration: rectified pairs with epipolar lines, where the corners lay, and each view's error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.photometry import to_8_bit, to_gray
from modules.rectification.calibrate import GRID, RigCalibration
from modules.rectification.chessboard import BoardView
from modules.rectification.rectify import rectify_images
from modules.types import Image

Canvas = NDArray[np.uint8]

PANEL_PX = 560  # width of one image in the picture
MARGIN_PX = 12
CAPTION_PX = 26
LINES = 14
INK = (40, 40, 40)
LINE_COLOURS = ((255, 140, 0), (0, 170, 220))
USED, DROPPED = (20, 130, 60), (210, 30, 40)


def draw_calibration(
    made: RigCalibration, views: Sequence[BoardView], shown: Sequence[tuple[str, Image, Image]]
) -> Canvas:
    """Draw a calibration.

    Parameters
    ----------
    made : RigCalibration
    views : sequence of BoardView
    shown : sequence of (caption, left, right)
        Raw pairs to show rectified.

    Returns
    -------
    uint8 (H, W, 3)
        RGB. One row of panels per pair shown, then the corners of all views on both images, then the errors.
    """
    rows = [
        _row([_panel(image) for image in _with_lines(made, left, right)], caption) for caption, left, right in shown
    ]
    used = {error.name: error.used for error in made.errors}
    size = (made.rig.left.width_px, made.rig.left.height_px)
    covered = [_coverage(views, used, side, size) for side in ("left_px", "right_px")]
    caption = f"corners of all views: left {made.coverage[0]:.0%}, right {made.coverage[1]:.0%} of the cells covered"
    rows.append(_row([_panel(image) for image in covered], caption))
    rows.append(_bars(made, rows[0].shape[1]))
    return np.concatenate(rows, axis=0)


def _with_lines(made: RigCalibration, left: Image, right: Image) -> tuple[Canvas, Canvas]:
    pair = rectify_images(left, right, made.rig)
    images = []
    for image, mask in ((pair.left, pair.left_mask), (pair.right, pair.right_mask)):
        canvas = _colour(image)
        canvas[~mask] = canvas[~mask] // 3
        for index in range(LINES):
            row = round((index + 0.5) * canvas.shape[0] / LINES)
            cv2.line(canvas, (0, row), (canvas.shape[1], row), LINE_COLOURS[index % 2], 1)
        images.append(canvas)
    return images[0], images[1]


def _coverage(views: Sequence[BoardView], used: dict[str, bool], side: str, size: tuple[int, int]) -> Canvas:
    canvas: Canvas = np.full((size[1], size[0], 3), 245, np.uint8)
    for index in range(1, GRID):
        for a, b in (
            ((index * size[0] // GRID, 0), (index * size[0] // GRID, size[1])),
            ((0, index * size[1] // GRID), (size[0], index * size[1] // GRID)),
        ):
            cv2.line(canvas, a, b, (215, 215, 215), 1)
    for view in views:
        for x, y in getattr(view, side):
            cv2.circle(canvas, (round(float(x)), round(float(y))), 3, USED if used[view.name] else DROPPED, -1)
    return canvas


def _bars(made: RigCalibration, width: int) -> Canvas:
    """Draw reprojection and epipolar error of each view, dropped views in red."""
    height, left, bottom = 240, 70, 34
    canvas: Canvas = np.full((height, width, 3), 255, np.uint8)
    title = f"px per view: reprojection (filled, {made.total('reprojection_px'):.2f} over all), "
    title += f"epipolar (outline, {made.total('epipolar_px'):.2f}); dropped views red"
    _text(canvas, title, (MARGIN_PX, 18))
    # Dropped views may be off by far; their bars end at the top with the number above.
    top = 1.3 * max(max(e.reprojection_px, e.epipolar_px) for e in made.errors if e.used)
    step = (width - left - MARGIN_PX) / max(len(made.errors), 1)
    reach = height - bottom - 50
    for level in (0.0, 0.5 * top, top):
        y = round(height - bottom - reach * level / top)
        cv2.line(canvas, (left, y), (width - MARGIN_PX, y), (225, 225, 225), 1)
        _text(canvas, f"{level:.2f}", (MARGIN_PX, y + 5))
    for index, error in enumerate(made.errors):
        colour = USED if error.used else DROPPED
        for part, (value, thickness) in enumerate(((error.reprojection_px, -1), (error.epipolar_px, 1))):
            x = round(left + step * (index + 0.15 + 0.35 * part))
            y = round(height - bottom - reach * min(value, top) / top)
            cv2.rectangle(canvas, (x, y), (round(x + 0.3 * step), height - bottom), colour, thickness)
        if max(error.reprojection_px, error.epipolar_px) > top:
            _text(canvas, f"{error.reprojection_px:.1f}", (round(left + step * (index + 0.1)), 44), colour)
        _text(canvas, error.name[-8:], (round(left + step * (index + 0.15)), height - 12), colour)
    return canvas


def _colour(image: Image) -> Canvas:
    gray = to_8_bit(to_gray(image))
    return np.ascontiguousarray(np.repeat(gray[..., None], 3, axis=2))


def _panel(image: Canvas) -> Canvas:
    height = round(image.shape[0] * PANEL_PX / image.shape[1])
    return np.asarray(cv2.resize(image, (PANEL_PX, height), interpolation=cv2.INTER_AREA), np.uint8)


def _row(panels: list[Canvas], caption: str) -> Canvas:
    height = panels[0].shape[0] + CAPTION_PX + MARGIN_PX
    canvas: Canvas = np.full((height, 2 * PANEL_PX + 3 * MARGIN_PX, 3), 255, np.uint8)
    _text(canvas, caption, (MARGIN_PX, 18))
    for index, panel in enumerate(panels):
        x = MARGIN_PX + index * (PANEL_PX + MARGIN_PX)
        canvas[CAPTION_PX : CAPTION_PX + panel.shape[0], x : x + PANEL_PX] = panel
    return canvas


def _text(canvas: Canvas, text: str, at: tuple[int, int], colour: tuple[int, int, int] = INK) -> None:
    font: Any = cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(canvas, text, at, font, 0.45, colour, 1, cv2.LINE_AA)
