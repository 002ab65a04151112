"""Occupancy maps for the map_server of ROS 2: a PGM picture and a YAML file beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import write_bytes, write_text
from modules.formats.errors import FormatError
from modules.types import ElevationMap, Hazard

OCCUPIED, FREE, UNKNOWN = 0, 254, 128  # UNKNOWN lies between the thresholds of every version of the server
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.25


def occupancy_of(grid: ElevationMap) -> NDArray[np.int8]:
    """Return 100 for hazards, 0 for free cells and -1 for unknown ones, int8 (H, W), rows along y as in OccupancyGrid.

    Hazards are those of the cell itself: a navigation stack inflates them by its own footprint.

    Raises
    ------
    FormatError
        When the map has no layer `hazard`.
    """
    if "hazard" not in grid.layers:
        raise FormatError("an occupancy map needs the layer 'hazard'; run reconstruction.assess_traversability")
    hazard = np.asarray(grid.layers["hazard"])
    occupied = np.where(hazard == Hazard.NONE, 0, 100)
    return np.where(hazard == Hazard.UNKNOWN, -1, occupied).astype(np.int8)


def write_occupancy(path: Path | str, grid: ElevationMap) -> None:
    """Write `path` (YAML) and the picture with the suffix .pgm beside it.

    The first row of the picture is the highest y; the origin is the lower left corner of the lower left cell.

    Raises
    ------
    FormatError
        When the map has no layer `hazard`, or a path cannot be written.
    """
    path = Path(path)
    occupancy = occupancy_of(grid)[::-1]
    values = np.select([occupancy == 100, occupancy == 0], [OCCUPIED, FREE], UNKNOWN).astype(np.uint8)
    picture = path.with_suffix(".pgm")
    rows, columns = values.shape
    write_bytes(picture, f"P5\n{columns} {rows}\n255\n".encode("ascii") + values.tobytes())
    write_text(
        path,
        f"image: {picture.name}\nmode: trinary\nresolution: {grid.cell_m:.9g}\n"
        f"origin: [{grid.x0_m:.9g}, {grid.y0_m:.9g}, 0.0]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESHOLD}\nfree_thresh: {FREE_THRESHOLD}\n",
    )
