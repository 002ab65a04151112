"""Maps of the terrain and its view in three dimensions, from the layers that a run wrote."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from expert.report.pictures import Picture, decode, picture
from modules.formats.errors import FormatError
from modules.formats.layers import parse_layers
from modules.formats.terrain_pictures import KINDS, NEEDED, Kind, MapDrawing, Scale, draw_map, round_step, upright
from modules.formats.viewer import viewer_page
from modules.types import ElevationMap

WANTED = frozenset({"elevation", "sigma_m", "filled", "slope_deg", "traversability", "hazard", "sight"})
MAX_CELLS = 200_000  # of the view in three dimensions: 2.4 MB; larger maps are thinned out
TITLES: Mapping[Kind, tuple[str, str]] = {
    "relief": ("Relief", "Shaded by a sun at the upper left and coloured by height"),
    "height": ("Height", "Height above the level plane"),
    "slope": ("Slope", "Tilt of the patch about each cell; grey where the patch is incomplete"),
    "traversability": (
        "Traversability",
        "Lowest goodness under the rover standing there; hazards of the cells in full colour",
    ),
    "coverage": ("Coverage", "Why a cell is known or not"),
}
ORTHO = ("Seen from above", "Mean colour of the pixels in each cell")


@dataclass(frozen=True)
class Ring:
    """A circle about the rover, in cells of the picture, with its radius as text and where that stands."""

    radius: float
    text: str
    x: float
    y: float


@dataclass(frozen=True)
class TerrainMap:
    """One map.

    Attributes
    ----------
    bar : str
        CSS colours from low to high; empty where there is no scale.
    classes : tuple of (CSS colour, meaning)
    """

    title: str
    meaning: str
    shown: Picture
    bar: str = ""
    low: str = ""
    high: str = ""
    classes: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Terrain:
    """All maps, the rings to draw over each, and the page of the view in three dimensions.

    Attributes
    ----------
    centre : (float, float)
        Of the rings, in cells of the picture.
    size : str
        Extent and cell in words.
    text_size : float
        Of the labels of the rings, in cells.
    page : str
    """

    maps: tuple[TerrainMap, ...]
    rings: tuple[Ring, ...]
    centre: tuple[float, float]
    size: str
    text_size: float
    page: str


def terrain(files: Mapping[str, bytes], title: str) -> Terrain | None:
    """Draw the terrain; None where the run wrote no layers or no cell is known.

    Raises
    ------
    ValueError
        A file is damaged.
    """
    if "layers.npz" not in files:
        return None
    try:
        grid = parse_layers("layers.npz", files["layers.npz"], WANTED)
    except FormatError as error:
        raise ValueError(str(error)) from error
    if not np.isfinite(np.asarray(grid.layers.get("elevation", np.nan))).any():
        return None
    ortho = decode("ortho.png", files["ortho.png"]).astype(np.uint8) if "ortho.png" in files else None
    rows, columns = grid.shape
    if ortho is not None and ortho.shape != (columns, rows, 3):
        raise ValueError(f"ortho.png is {ortho.shape} and the layers are {grid.shape}; run the pair again")
    maps = [_map(kind, draw_map(grid, kind)) for kind in KINDS if NEEDED.get(kind, "elevation") in grid.layers]
    if ortho is not None:
        maps.append(TerrainMap(*ORTHO, picture(ortho, photo=False)))
    centre = (grid.y0_m / grid.cell_m + rows, grid.x0_m / grid.cell_m + columns)
    size = f"{columns * grid.cell_m:.1f} m ahead by {rows * grid.cell_m:.1f} m across, cells of {grid.cell_m:.3g} m"
    page = viewer_page(grid, None if ortho is None else upright(ortho), title, MAX_CELLS)
    return Terrain(tuple(maps), tuple(_rings(grid, centre)), centre, size, max(rows, columns) / 22.0, page)


def _map(kind: Kind, drawn: MapDrawing) -> TerrainMap:
    title, meaning = TITLES[kind]
    if kind == "relief":
        meaning = f"{meaning}, {drawn.words}"
    classes = tuple((_css(colour), words) for colour, words in drawn.classes)
    shown = picture(drawn.colours, photo=False)
    if drawn.scale is None:
        return TerrainMap(title, meaning, shown, classes=classes)
    low, high = (f"{end:.3g} {drawn.scale.unit}".strip() for end in (drawn.scale.low, drawn.scale.high))
    return TerrainMap(title, meaning, shown, _bar(drawn.scale), low, high, classes)


def _bar(scale: Scale) -> str:
    return ", ".join(_css(tuple(scale.colours[index])) for index in range(0, 256, 15))


def _css(colour: tuple[int, ...]) -> str:
    return "#" + "".join(f"{int(part):02x}" for part in colour)


def _rings(grid: ElevationMap, centre: tuple[float, float]) -> Iterator[Ring]:
    """Yield circles at round distances; each is labelled on the line from the rover through the middle of the map."""
    rows, columns = grid.shape
    corners = [(x, y) for x in (0.0, rows) for y in (0.0, columns)]
    farthest = max(math.dist(centre, corner) for corner in corners) * grid.cell_m
    step = round_step(farthest / 6.0)
    ahead = (rows / 2.0 - centre[0], columns / 2.0 - centre[1])
    length = max(math.hypot(*ahead), 1.0)
    for number in range(1, 1 + int(farthest / step)):
        radius = number * step / grid.cell_m
        x, y = (centre[axis] + radius * ahead[axis] / length for axis in (0, 1))
        inside = 0.0 <= x <= rows and 0.0 <= y <= columns
        yield Ring(radius, f"{number * step:g} m" if inside else "", x, y)
