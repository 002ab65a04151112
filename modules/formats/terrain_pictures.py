"""Pictures of an elevation map for people: relief, height, slope and traversability, with scale, rings and legends."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.formats.errors import FormatError
from modules.formats.images import write_image
from modules.types import ElevationMap, FloatImage, Hazard, Mask, Sight

Kind = Literal["relief", "height", "slope", "traversability", "coverage"]
KINDS: tuple[Kind, ...] = get_args(Kind)
Colours = NDArray[np.uint8]
T = TypeVar("T", bound=np.generic)

VERTICAL_STRETCH = 1.5
SUN = (0.5, 0.5, 0.70710678)  # unit vector to the sun: ahead, left and up, which is the upper left of the picture
MAP_SIDE_PX = 840
MARGIN_PX, HEAD_PX, FOOT_PX, BAR_PX = 12, 34, 46, 96
UNKNOWN = (44, 46, 52)
INK, PAPER, RING = (24, 26, 30), (255, 255, 255), (255, 255, 255)
FONT = cv2.FONT_HERSHEY_SIMPLEX
STEEPEST_DEG = 40.0  # end of the scale of slopes
HAZARD_COLOURS = {
    Hazard.STEP: (178, 24, 43),
    Hazard.ROUGHNESS: (118, 42, 131),
    Hazard.SLOPE: (224, 130, 20),
}


NEEDED = {"slope": "slope_deg", "traversability": "traversability", "coverage": "sight"}
"""The layers that kinds need beside the elevation."""

HAZARD_WORDS = {Hazard.STEP: "step", Hazard.ROUGHNESS: "roughness", Hazard.SLOPE: "slope"}
SIGHT_COLOURS = {
    Sight.MEASURED: (92, 158, 100),
    Sight.OCCLUDED: (91, 103, 160),
    Sight.UNMATCHED: (214, 126, 60),
    Sight.OUT_OF_VIEW: UNKNOWN,
}
SIGHT_WORDS = {
    Sight.MEASURED: "measured",
    Sight.OCCLUDED: "hidden by nearer terrain",
    Sight.UNMATCHED: "in view, but not measured",
    Sight.OUT_OF_VIEW: "out of view",
}
FILLED = (240, 214, 120)


@dataclass(frozen=True)
class Scale:
    """A colour bar: colours (256, 3) from low to high, and what they mean."""

    colours: Colours
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class MapDrawing:
    """A map, one pixel a cell.

    Attributes
    ----------
    colours : uint8 (H, W, 3)
        `upright`; cells that are not known are dark.
    scale : Scale or None
        None where the colours stand for kinds of cells.
    classes : tuple of (colour, meaning)
        Of the single colours that are not on the scale.
    words : str
    """

    colours: Colours
    scale: Scale | None
    classes: tuple[tuple[tuple[int, int, int], str], ...] = ()
    words: str = ""


def write_terrain_picture(path: Path | str, grid: ElevationMap, kind: Kind = "relief") -> None:
    """Write a map with forward (x) up and left (y) left, unknown cells dark, filled cells paler.

    Parameters
    ----------
    path : Path or str
        PNG.
    grid : ElevationMap
    kind : {"relief", "height", "slope", "traversability", "coverage"}
        Shaded relief coloured by height with contour lines; plain height; slope; the goodness under the rover with the
        hazards of the cells themselves; or why cells are known or not. The last three need the layers of
        `compute_slope`, `assess_traversability` and `trace_sight`.

    Raises
    ------
    FormatError
        When no cell is known, a layer is missing, or the path cannot be written.
    """
    try:
        drawing = draw_map(grid, kind)
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error
    write_image(path, _framed(_enlarged(drawing.colours), grid, kind, drawing))


def draw_map(grid: ElevationMap, kind: Kind) -> MapDrawing:
    """Colour a map, one pixel a cell.

    Raises
    ------
    ValueError
        When no cell is known, or a layer is missing.
    """
    elevation = np.asarray(grid.layers["elevation"], np.float32)
    known = np.isfinite(elevation)
    if not known.any():
        raise ValueError("no cell of the elevation grid is known, so there is nothing to draw")
    needed = NEEDED.get(kind, "elevation")
    if needed not in grid.layers:
        raise ValueError(f"the map has no layer '{needed}'; run the operator that makes it")
    if kind == "coverage":
        return _coverage(grid, known)
    drawn, scale, words = _DRAWERS[kind](grid, elevation, known)
    classes = [(UNKNOWN, "unknown")]
    filled = grid.layers.get("filled")
    if kind == "traversability":
        classes = [(HAZARD_COLOURS[code], word) for code, word in HAZARD_WORDS.items()] + classes
    elif filled is not None:
        drawn = np.where(np.asarray(filled, bool)[..., None], drawn * 0.7 + 255 * 0.3, drawn)
    coloured: Colours = np.where(known[..., None], drawn, UNKNOWN).astype(np.uint8)
    return MapDrawing(upright(coloured), scale, tuple(classes), words)


def _coverage(grid: ElevationMap, known: Mask) -> MapDrawing:
    sight, filled = np.asarray(grid.layers["sight"]), known & (np.asarray(grid.layers["sight"]) != Sight.MEASURED)
    drawn = np.full((*known.shape, 3), UNKNOWN, np.uint8)
    kinds = [(sight == code, colour, SIGHT_WORDS[code]) for code, colour in SIGHT_COLOURS.items()]
    kinds = [(cells & ~filled, colour, words) for cells, colour, words in kinds]
    kinds.insert(1, (filled, FILLED, "filled from its neighbours"))
    for cells, colour, _ in kinds:
        drawn[cells] = colour
    shares = [(colour, words, 100.0 * np.count_nonzero(cells) / cells.size) for cells, colour, words in kinds]
    classes = tuple((colour, f"{words} ({share:.1f} %)") for colour, words, share in shares)
    return MapDrawing(upright(drawn), None, classes, "green measured, yellow filled, blue hidden, orange not measured")


def write_ortho(path: Path | str, grid: ElevationMap, colours: Colours) -> None:
    """Write the colours (H, W, 3) of the cells from above, one pixel a cell, `upright`; unknown cells are dark.

    Raises
    ------
    FormatError
        When the path cannot be written.
    """
    known = np.isfinite(np.asarray(grid.layers["elevation"]))
    write_image(path, upright(np.where(known[..., None], colours, UNKNOWN).astype(np.uint8)))


def upright(cells: NDArray[T]) -> NDArray[T]:
    """Turn rows of y and columns of x so that forward (x) is up and left (y) is left; doing it twice undoes it."""
    return np.ascontiguousarray(cells.swapaxes(0, 1)[::-1, ::-1])


def _palette(map_id: int) -> Colours:
    ramp = np.arange(256, dtype=np.uint8).reshape(-1, 1)
    return np.asarray(cv2.applyColorMap(ramp, map_id)[:, 0, ::-1], np.uint8)


def _coloured(values: FloatImage, scale: Scale) -> Colours:
    tone = np.clip((values - scale.low) / max(scale.high - scale.low, 1e-6), 0.0, 1.0)
    return scale.colours[np.rint(np.nan_to_num(tone) * 255.0).astype(np.uint8)]


def _height_scale(elevation: FloatImage, known: Mask) -> Scale:
    low, high = (float(value) for value in np.percentile(elevation[known], [2.0, 98.0]))
    return Scale(_palette(cv2.COLORMAP_VIRIDIS), low, max(high, low + 0.01), "m")


def _relief(grid: ElevationMap, elevation: FloatImage, known: Mask) -> tuple[FloatImage, Scale, str]:
    scale = _height_scale(elevation, known)
    height = _extended(elevation, known)
    picture = _coloured(height, scale) * (0.3 + 0.75 * _shade(height, grid.cell_m))[..., None]
    step = round_step((scale.high - scale.low) / 8.0)
    picture = np.where(_contours(height, known, step)[..., None], picture * 0.5, picture)
    words = f"contours every {step:g} m, {_reach(elevation, known)}"
    return picture.clip(0, 255).astype(np.float32), scale, words


def _height(grid: ElevationMap, elevation: FloatImage, known: Mask) -> tuple[FloatImage, Scale, str]:
    scale = _height_scale(elevation, known)
    return _coloured(elevation, scale).astype(np.float32), scale, _reach(elevation, known)


def _reach(elevation: FloatImage, known: Mask) -> str:
    """Say the lowest and the highest height, which lie beyond the ends of the colours."""
    return f"heights from {elevation[known].min():.2f} to {elevation[known].max():.2f} m"


def _slope(grid: ElevationMap, elevation: FloatImage, known: Mask) -> tuple[FloatImage, Scale, str]:
    scale = Scale(_palette(cv2.COLORMAP_INFERNO), 0.0, STEEPEST_DEG, "deg")
    slope = np.asarray(grid.layers["slope_deg"], np.float32)
    picture = _coloured(slope, scale).astype(np.float32)
    return (
        np.where(np.isfinite(slope)[..., None], picture, 128.0).astype(np.float32),
        scale,
        f"colours end at {STEEPEST_DEG:g} deg, grey: patch incomplete",
    )


def _traversability(grid: ElevationMap, elevation: FloatImage, known: Mask) -> tuple[FloatImage, Scale, str]:
    ramp = np.linspace(0.0, 1.0, 256)[:, None]
    low, middle, high = (np.array(c, float) for c in ((216, 116, 96), (246, 226, 158), (92, 158, 100)))
    colours = np.where(ramp < 0.5, low + (middle - low) * 2 * ramp, middle + (high - middle) * (2 * ramp - 1))
    scale = Scale(np.rint(colours).astype(np.uint8), 0.0, 1.0, "")
    shade = 0.75 + 0.3 * _shade(_extended(elevation, known), grid.cell_m)[..., None]
    picture = _coloured(np.asarray(grid.layers["traversability"], np.float32), scale) * shade
    hazard = np.asarray(grid.layers["hazard"]) if "hazard" in grid.layers else np.zeros(known.shape, np.uint8)
    for code, colour in HAZARD_COLOURS.items():
        picture = np.where((hazard == code)[..., None], colour, picture)
    return (
        picture.clip(0, 255).astype(np.float32),
        scale,
        "1 safe, 0 not; hazards: red step, violet roughness, orange slope",
    )


_DRAWERS = {"relief": _relief, "height": _height, "slope": _slope, "traversability": _traversability}
_TITLES = {
    "relief": "Height above the origin",
    "height": "Height above the origin",
    "slope": "Slope",
    "traversability": "Traversability",
    "coverage": "Coverage",
}


def _extended(elevation: FloatImage, known: Mask) -> FloatImage:
    """Continue the heights into unknown cells, so that no cliff is drawn at their border."""
    from scipy.ndimage import distance_transform_edt

    if known.all():
        return elevation
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(elevation[tuple(nearest)])


def _shade(height: FloatImage, cell_m: float) -> FloatImage:
    """Return the cosine between the surface and the sun, (H, W), 0-1."""
    smooth = cv2.GaussianBlur(height, (0, 0), 0.7)
    gy, gx = np.gradient(smooth * VERTICAL_STRETCH, cell_m) if min(height.shape) > 1 else np.zeros((2, *height.shape))
    dot = (-gx * SUN[0] - gy * SUN[1] + SUN[2]) / np.sqrt(gx**2 + gy**2 + 1.0)
    return np.clip(dot, 0.0, 1.0).astype(np.float32)


def _contours(height: FloatImage, known: Mask, step_m: float) -> Mask:
    """Return the cells where the smoothed height passes a multiple of the step."""
    band = np.floor(cv2.GaussianBlur(height, (0, 0), 1.5) / step_m)
    edge = np.zeros(height.shape, bool)
    edge[1:] |= (band[1:] != band[:-1]) & known[1:] & known[:-1]
    edge[:, 1:] |= (band[:, 1:] != band[:, :-1]) & known[:, 1:] & known[:, :-1]
    return edge


def round_step(value: float) -> float:
    """Return the nearest of 1, 2, 5 times a power of ten that is not smaller."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-6)))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= value * 0.999)


def _enlarged(drawn: Colours) -> Colours:
    """Enlarge by a whole factor."""
    side = max(drawn.shape[:2])
    if side > 2 * MAP_SIDE_PX:
        scale = MAP_SIDE_PX / side
        size = (max(1, round(drawn.shape[1] * scale)), max(1, round(drawn.shape[0] * scale)))
        return np.asarray(cv2.resize(drawn, size, interpolation=cv2.INTER_AREA), np.uint8)
    factor = max(1, MAP_SIDE_PX // side)
    return np.repeat(np.repeat(drawn, factor, axis=0), factor, axis=1)


def _framed(drawn: Colours, grid: ElevationMap, kind: Kind, drawing: MapDrawing) -> Colours:
    """Put the map on paper with rings about the origin, a title, a scale bar and a colour bar."""
    height, width = drawn.shape[:2]
    px_per_m = width / (grid.shape[0] * grid.cell_m)
    _draw_rings(drawn, grid, px_per_m)
    total = max(width, 520)
    canvas = np.full((HEAD_PX + height + FOOT_PX, MARGIN_PX + total + BAR_PX, 3), PAPER, np.uint8)
    left = MARGIN_PX + (total - width) // 2
    canvas[HEAD_PX : HEAD_PX + height, left : left + width] = drawn
    title = ": ".join(part for part in (_TITLES[kind], drawing.words) if part)
    _text(canvas, title, (MARGIN_PX, 22), 0.5)
    y = HEAD_PX + height + 16
    bar_m = round_step(total / px_per_m / 6.0)
    cv2.rectangle(canvas, (MARGIN_PX, y - 5), (MARGIN_PX + round(bar_m * px_per_m), y), INK, -1)
    _text(canvas, f"{bar_m:g} m", (MARGIN_PX, y + 18), 0.45)
    unknown = f"dark: {'out of view' if kind == 'coverage' else 'unknown'}" + (
        ", pale: filled" if kind in _DRAWERS and kind != "traversability" else ""
    )
    _text(canvas, f"x ahead is up, y left; rings about the rover; {unknown}", (MARGIN_PX + 90, y + 18), 0.42)
    if drawing.scale is not None:
        _draw_colour_bar(canvas, drawing.scale, MARGIN_PX + total + 14, HEAD_PX + 8, min(height - 16, 320))
    return canvas


def _draw_rings(drawn: Colours, grid: ElevationMap, px_per_m: float) -> None:
    """Draw circles about the origin of the frame, labelled with their radius."""
    top = grid.x0_m + grid.shape[1] * grid.cell_m  # the first row is the largest x
    left = grid.y0_m + grid.shape[0] * grid.cell_m
    centre = (round(left * px_per_m), round(top * px_per_m))
    corners = [(x, y) for x in (grid.x0_m, top) for y in (grid.y0_m, left)]
    farthest = max(math.hypot(x, y) for x, y in corners)
    step = round_step(farthest / 6.0)
    # Labels stand along the line from the rover through the middle of the map.
    middle = (drawn.shape[1] / 2.0 - centre[0], drawn.shape[0] / 2.0 - centre[1])
    length = max(math.hypot(*middle), 1.0)
    for number in range(1, 1 + int(farthest / step)):
        radius = number * step * px_per_m
        cv2.circle(drawn, centre, round(radius), RING, 1, cv2.LINE_AA)
        place = (
            round(centre[0] + radius * middle[0] / length) + 4,
            round(centre[1] + radius * middle[1] / length) - 4,
        )
        if 12 < place[1] < drawn.shape[0] and 0 <= place[0] < drawn.shape[1] - 40:
            label = f"{number * step:g} m"
            cv2.putText(drawn, label, place, FONT, 0.42, INK, 3, cv2.LINE_AA)
            cv2.putText(drawn, label, place, FONT, 0.42, RING, 1, cv2.LINE_AA)


def _draw_colour_bar(canvas: Colours, scale: Scale, x: int, y: int, height: int) -> None:
    if height < 40:
        return
    ramp = scale.colours[np.linspace(255, 0, height).astype(np.uint8)]
    canvas[y : y + height, x : x + 16] = ramp[:, None]
    step = round_step((scale.high - scale.low) / 6.0)
    first = math.ceil(scale.low / step - 1e-9)
    for number in range(first, 1 + math.floor(scale.high / step + 1e-9)):
        value = number * step
        row = y + round((height - 1) * (scale.high - value) / (scale.high - scale.low))
        cv2.line(canvas, (x + 16, row), (x + 21, row), INK, 1)
        _text(canvas, f"{value:g} {scale.unit}".strip(), (x + 24, row + 4), 0.4)


def _text(canvas: Colours, text: str, place: tuple[int, int], size: float) -> None:
    cv2.putText(canvas, text, place, FONT, size, INK, 1, cv2.LINE_AA)
