"""One page with the terrain in three dimensions; it needs no other file and no network."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import write_text
from modules.formats.errors import FormatError
from modules.formats.terrain_pictures import round_step
from modules.primitives.surface import cell_colours
from modules.types import ElevationMap, Mask, PointCloud

MAX_CELLS = 500_000  # 9 bytes each, a third more as base64: 6 MB
NO_HEIGHT, HEIGHT_LEVELS = 65535, 65534
NO_VALUE, VALUE_LEVELS = 255, 254
STEEPEST_DEG = 40.0


def write_viewer(
    path: Path | str, grid: ElevationMap, points: PointCloud | None = None, title: str = "terrain"
) -> None:
    """Write a page that shows the elevation map as a surface.

    It is coloured by the image, height, sigma, slope or traversability, as far as the map has these layers. A map of
    more than half a million cells is thinned out so that the page stays below 8 MB.

    Parameters
    ----------
    path : Path or str
    grid : ElevationMap
    points : PointCloud, optional
        For the colours of the image.
    title : str
        Shown as text.

    Raises
    ------
    FormatError
        When no cell is known, or the path cannot be written.
    """
    if not np.isfinite(np.asarray(grid.layers["elevation"])).any():
        raise FormatError(f"{path}: no cell of the elevation grid is known, so there is nothing to show")
    colours = None if points is None or points.rgb is None else cell_colours(grid, points)
    write_text(Path(path), viewer_page(grid, colours, title))


def viewer_page(
    grid: ElevationMap, colours: NDArray[np.uint8] | None = None, title: str = "terrain", max_cells: int = MAX_CELLS
) -> str:
    """Return the page of `write_viewer`.

    Parameters
    ----------
    grid : ElevationMap
        At least one cell is known.
    colours : uint8 (H, W, 3), optional
        Of the image, for each cell.
    title : str
    max_cells : int
        A larger map is thinned out; a cell takes 12 bytes.
    """
    thin = max(1, math.ceil(math.sqrt(grid.layers["elevation"].size / max_cells)))
    data = _data(grid, colours, thin)
    page = files("modules.formats").joinpath("viewer.html").read_text(encoding="utf-8")
    content = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    for mark, text in (
        ("@HASH@", viewer_script_hash()),
        ("@TITLE@", html.escape(title)),
        ("@SCRIPT@", _script()),
        ("@DATA@", content),
    ):
        page = page.replace(mark, text)
    return page


def _script() -> str:
    return files("modules.formats").joinpath("viewer.js").read_text(encoding="utf-8")


def viewer_script_hash() -> str:
    """Return the hash of the page's script, as a content security policy names it."""
    digest = hashlib.sha256(_script().encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"


def _data(grid: ElevationMap, colours: NDArray[np.uint8] | None, thin: int) -> dict[str, object]:
    z = np.asarray(grid.layers["elevation"], np.float64)[::thin, ::thin]
    known = np.isfinite(z)
    low, high = float(z[known].min()), float(z[known].max())
    high = max(high, low + 1e-3)
    height = np.where(known, np.rint((np.nan_to_num(z) - low) / (high - low) * HEIGHT_LEVELS), NO_HEIGHT)
    cell = grid.cell_m * thin
    # The centre of a thinned cell is that of the cell that was kept.
    x0 = grid.x0_m + 0.5 * grid.cell_m - 0.5 * cell
    y0 = grid.y0_m + 0.5 * grid.cell_m - 0.5 * cell
    rows, columns = np.nonzero(known)
    x, y = x0 + (columns + 0.5) * cell, y0 + (rows + 0.5) * cell
    middle = [float(np.median(x)), float(np.median(y)), float(np.median(z[known]))]
    farthest = float(np.hypot(x, y).max())
    shown = {"rows": z.shape[0], "columns": z.shape[1], "x0": x0, "y0": y0, "cell": cell, "zMin": low, "zMax": high}
    data: dict[str, object] = {
        **shown,
        "centre": middle,
        "reach": float(max(np.ptp(x), np.ptp(y), cell)),
        "farthest": farthest,
        "ring": round_step(farthest / 8.0),
        "height": _base64(height.astype("<u2")),
        "size": f"{np.count_nonzero(known)} cells of {cell:.3g} m" + (f", every {thin}th" if thin > 1 else ""),
    }
    data["layers"] = _layers(grid, colours, thin, known, data)
    return data


def _layers(
    grid: ElevationMap,
    colours: NDArray[np.uint8] | None,
    thin: int,
    known: Mask,
    data: dict[str, object],
) -> list[dict[str, str]]:
    """Put the colours into `data` and return what the page offers to choose, in order."""
    offered = []
    if colours is not None:
        data["image"] = _base64(colours[::thin, ::thin])
        offered.append({"name": "image", "title": "image", "note": "mean colour of the pixels in the cell"})
    elevation = np.asarray(grid.layers["elevation"], np.float64)
    low, high = (float(value) for value in np.nanpercentile(elevation, [1.0, 99.0]))
    ranges = {"height": ("elevation", low, high, "m", "height above the level plane")}
    if "sigma_m" in grid.layers:
        sigma = np.asarray(grid.layers["sigma_m"], np.float64)
        top = float(np.nanpercentile(sigma, 95)) if np.isfinite(sigma).any() else 1.0
        ranges["sigma"] = (
            "sigma_m",
            0.0,
            top,
            "m",
            "standard deviation of the height, 95 % of the cells below the end",
        )
    if "slope_deg" in grid.layers:
        ranges["slope"] = ("slope_deg", 0.0, STEEPEST_DEG, "deg", "tilt of the patch; grey where it is incomplete")
    if "traversability" in grid.layers:
        ranges["traversability"] = ("traversability", 0.0, 1.0, "", "lowest goodness under the rover; red is a hazard")
    for name, (layer, first, last, unit, note) in ranges.items():
        values = np.asarray(grid.layers[layer], np.float64)[::thin, ::thin]
        tone = np.clip((values - first) / max(last - first, 1e-9), 0.0, 1.0) * VALUE_LEVELS
        usable = known & np.isfinite(values)
        data[f"layer_{name}"] = _base64(np.where(usable, np.rint(np.nan_to_num(tone)), NO_VALUE).astype(np.uint8))
        ends = {"low": f"{first:.3g} {unit}".strip(), "high": f"{last:.3g} {unit}".strip()}
        offered.append({"name": name, "title": name, "note": note, **ends})
    return offered


def _base64(values: NDArray[np.generic]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
