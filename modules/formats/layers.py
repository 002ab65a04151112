"""All layers of an elevation map in one NPZ: in this project's conventions, and in those of grid_map."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Container
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import write_bytes
from modules.formats.errors import FormatError
from modules.primitives.layers import LAYERS, unit_of
from modules.types import ElevationMap, Hazard

PREFIX = "layer_"
COMPRESSION = 1  # half the time of the usual 6, and files 3 % larger
GRID_MAP_NAMES = {
    "roughness_m": "roughness",  # filters_demo_filter_chain.yaml of grid_map_demos, as slope and traversability
    "step_m": "step_height",  # StepFilter.cpp of traversability_estimation_filters
    "normal_x": "normal_vectors_x",  # the prefix of the filter chains of grid_map_demos and elevation_mapping_demos
    "normal_y": "normal_vectors_y",
    "normal_z": "normal_vectors_z",
}
"""Names that layers have in the packages around grid_map, where they differ and nothing but the name does."""
BOUND_SIGMA = 2.0
"""Between the elevation and its bounds; ElevationMap.cpp of elevation_mapping."""


def write_layers(path: Path | str, grid: ElevationMap) -> None:
    """Write every layer as `layer_<name>`, and `description`, a JSON text with frame, place, cell, units and meanings.

    Raises
    ------
    FormatError
        When the path cannot be written.
    """
    described = {
        name: {"unit": unit_of(name), "meaning": LAYERS[name].meaning if name in LAYERS else ""} for name in grid.layers
    }
    text = json.dumps(
        {
            "frame": grid.frame,
            "x0_m": grid.x0_m,
            "y0_m": grid.y0_m,
            "cell_m": grid.cell_m,
            "cells": "cell (i, j) covers x0_m + j cell_m along x and y0_m + i cell_m along y, one cell wide",
            "layers": described,
        },
        indent=1,
    )
    arrays = {PREFIX + name: np.asarray(layer) for name, layer in grid.layers.items()}
    _write_npz(Path(path), {"description": np.array(text), **arrays})


def read_layers(path: Path | str) -> ElevationMap:
    """Read an NPZ that `write_layers` wrote.

    Raises
    ------
    FormatError
        When the file is missing or of another kind.
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"{path} does not exist; check the path of the layers")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check its permissions") from error
    return parse_layers(str(path), content)


def parse_layers(name: str, content: bytes, wanted: Container[str] | None = None) -> ElevationMap:
    """Read the content of an NPZ that `write_layers` wrote.

    Parameters
    ----------
    name : str
        Of the file, for the message.
    content : bytes
    wanted : container of str, optional
        Layers to read; all by default.

    Raises
    ------
    FormatError
        When it is of another kind.
    """
    try:
        with np.load(BytesIO(content), allow_pickle=False) as file:
            place = json.loads(str(file["description"]))
            found = [item.removeprefix(PREFIX) for item in file.files if item.startswith(PREFIX)]
            layers: dict[str, NDArray[np.generic]] = {
                layer: file[PREFIX + layer] for layer in found if wanted is None or layer in wanted
            }
        return ElevationMap(
            float(place["x0_m"]), float(place["y0_m"]), float(place["cell_m"]), layers, frame=str(place["frame"])
        )
    except (KeyError, TypeError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise FormatError(f"{name} holds no layers of an elevation map ({error}); write it with terrex") from error


def write_grid_map(path: Path | str, grid: ElevationMap) -> None:
    """Write the layers as a `grid_map` holds them: float32 matrices whose index (0, 0) is the cell of largest x and y.

    Rows run along falling x, columns along falling y, storage is column-major, NaN is unknown. `info` is a JSON text of
    the ROS 2 message `grid_map_msgs/GridMap` without its data: `header`, `info` (resolution, length_x, length_y and the
    pose of the map's centre), `layers`, `basic_layers`, the start indices, and the `layout` of each
    `Float32MultiArray`, whose data are the matrix in the order in which it is stored. (ROS 1 has `header` in `info`.)

    Layers have the names that the packages around grid_map read: `elevation`; `variance` of the elevation, m^2;
    `lower_bound` and `upper_bound`, two standard deviations from it; `slope`, rad; `roughness` and `step_height`, m;
    `normal_vectors_x`, `_y` and `_z`; `traversability`, 0 to 1 for safe. What has no name there keeps the one it has.
    A cell is valid where `elevation` is: a filled cell without an uncertainty has no bounds, but a height.

    References
    ----------
    P. Fankhauser and M. Hutter, "A Universal Grid Map Library: Implementation and Use Case for Rough Terrain
    Navigation", Robot Operating System (ROS), Springer, 2016. Read in the sources of ANYbotics/grid_map:
    `grid_map_msgs/msg/GridMap.msg` and `GridMapInfo.msg` (fields), `grid_map_core/src/GridMapMath.cpp` (position of an
    index), `grid_map_ros/GridMapMsgHelpers` (layout: `column_index` outside, `row_index` inside),
    `grid_map_demos/config/filters_demo_filter_chain.yaml` (slope as the arc cosine of the normal's z, roughness,
    traversability); of ANYbotics/elevation_mapping: `ElevationMap.cpp` (`variance` of the raw map, bounds of the fused
    one); of leggedrobotics/traversability_estimation: `StepFilter.cpp`.

    Raises
    ------
    FormatError
        When the path cannot be written.
    """
    rows, columns = grid.shape
    matrices = {name: _turned(layer) for name, layer in _renamed(grid).items()}
    length_x, length_y = columns * grid.cell_m, rows * grid.cell_m
    centre = {"x": grid.x0_m + 0.5 * length_x, "y": grid.y0_m + 0.5 * length_y, "z": 0.0}
    message = {
        "header": {"frame_id": grid.frame},
        "info": {
            "resolution": grid.cell_m,
            "length_x": length_x,
            "length_y": length_y,
            "pose": {"position": centre, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
        },
        "layers": list(matrices),
        "basic_layers": ["elevation"],
        "outer_start_index": 0,
        "inner_start_index": 0,
        "layout": {
            "dim": [
                {"label": "column_index", "size": rows, "stride": rows * columns},
                {"label": "row_index", "size": columns, "stride": columns},
            ],
            "data_offset": 0,
        },
    }
    _write_npz(Path(path), {"info": np.array(json.dumps(message)), **matrices})


def _renamed(grid: ElevationMap) -> dict[str, NDArray[np.float32]]:
    """Return the layers by the names and in the units of grid_map, float32 (H, W)."""
    known = np.isfinite(np.asarray(grid.layers["elevation"], np.float32))
    found: dict[str, NDArray[np.float32]] = {}
    for name, layer in grid.layers.items():
        values = np.asarray(layer).astype(np.float32)
        if name == "sigma_m":
            elevation, away = np.asarray(grid.layers["elevation"], np.float32), np.float32(BOUND_SIGMA) * values
            found |= {"variance": values**2, "lower_bound": elevation - away, "upper_bound": elevation + away}
        elif name == "slope_deg":
            found["slope"] = values * np.float32(math.pi / 180.0)
        elif name in ("hazard", "limiting_hazard"):
            found[name] = np.where(values == Hazard.UNKNOWN, np.float32(np.nan), values)
        elif name == "filled":
            found[name] = np.where(known, values, np.float32(np.nan))
        else:
            found[GRID_MAP_NAMES.get(name, name)] = values
    return found


def _turned(layer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Turn rows of y and columns of x into rows of falling x and columns of falling y, column-major."""
    return np.asfortranarray(layer.T[::-1, ::-1])


def _write_npz(path: Path, arrays: dict[str, NDArray[np.generic]]) -> None:
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=COMPRESSION) as archive:
        for name, values in arrays.items():
            # No date, so that equal layers give equal bytes; the size of an entry is not known before it is written.
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, values, allow_pickle=False)
    write_bytes(path, out.getvalue())
