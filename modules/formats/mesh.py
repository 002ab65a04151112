"""Meshes of an elevation map: OBJ and GLB."""

from __future__ import annotations

import json
import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import write_bytes
from modules.formats.errors import FormatError
from modules.primitives.surface import Surface, surface_of
from modules.types import ElevationMap, PointCloud

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
FLOAT, UNSIGNED_SHORT, UNSIGNED_INT = 5126, 5123, 5125
TO_Y_UP = (0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1)  # columns: x to z, y to x, z to y


def write_obj(path: Path | str, grid: ElevationMap, points: PointCloud | None = None) -> None:
    """Write a Wavefront OBJ, metres, z up, with a colour after each vertex as most readers take it.

    Raises
    ------
    FormatError
        When no cell is known, or the path cannot be written.
    """
    surface = _surface(path, grid, points)
    out = BytesIO()
    out.write(f"# terrex, frame {grid.frame}, metres, z up\n".encode("ascii"))
    vertices = np.column_stack([surface.vertices_m, surface.rgb / np.float32(255.0)])
    np.savetxt(out, vertices, "v %.6g %.6g %.6g %.4g %.4g %.4g")
    np.savetxt(out, surface.faces + 1, "f %d %d %d")
    write_bytes(Path(path), out.getvalue())


def write_glb(path: Path | str, grid: ElevationMap, points: PointCloud | None = None) -> None:
    """Write a binary glTF 2.0 with vertex colours.

    Vertices are in the frame of the map; the node turns them to the y-up axes of glTF, x ahead becoming z. Colours are
    linear, as glTF wants them, and the material is unlit, for the image has its own light.

    Raises
    ------
    FormatError
        When no cell is known, or the path cannot be written.
    """
    surface = _surface(path, grid, points)
    linear = np.rint(_linear(surface.rgb) * 65535.0).astype("<u2")
    colours = np.column_stack([linear, np.full(len(linear), 65535, "<u2")]).astype("<u2")
    vertices = surface.vertices_m.astype("<f4")
    blocks = (vertices.tobytes(), colours.tobytes(), surface.faces.astype("<u4").tobytes())
    views, start = [], 0
    for block, target in zip(blocks, (ARRAY_BUFFER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER), strict=True):
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(block), "target": target})
        start += len(block)
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "terrex"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "terrain", "matrix": TO_Y_UP}],
        "materials": [
            {
                "extensions": {"KHR_materials_unlit": {}},
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
                "doubleSided": True,
            }
        ],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0, "mode": 4}]}
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": FLOAT,
                "count": len(vertices),
                "type": "VEC3",
                "min": vertices.min(axis=0).tolist(),
                "max": vertices.max(axis=0).tolist(),
            },
            {
                "bufferView": 1,
                "componentType": UNSIGNED_SHORT,
                "normalized": True,
                "count": len(vertices),
                "type": "VEC4",
            },
            {"bufferView": 2, "componentType": UNSIGNED_INT, "count": int(surface.faces.size), "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    binary = b"".join(blocks)
    total = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON")
    write_bytes(Path(path), head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary)


def _surface(path: Path | str, grid: ElevationMap, points: PointCloud | None) -> Surface:
    surface = surface_of(grid, points)
    if len(surface.faces) == 0:
        raise FormatError(f"{path}: no three neighbouring cells of the elevation map are known, so there is no mesh")
    return surface


def _linear(rgb: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return linear light, 0-1, of sRGB bytes."""
    value = rgb / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
