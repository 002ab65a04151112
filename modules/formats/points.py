"""Point clouds: PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modules.formats._text import write_bytes
from modules.formats.errors import FormatError
from modules.formats.images import _content
from modules.types import PointCloud


def write_ply(path: Path | str, points: PointCloud) -> None:
    """Write binary little-endian PLY: x, y, z float (m), red, green, blue uchar where there are colours."""
    fields: list[tuple[str, str]] = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    if points.rgb is not None:
        fields += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    vertices = np.empty(len(points), dtype=fields)
    for index, name in enumerate("xyz"):
        vertices[name] = points.xyz_m[:, index]
    if points.rgb is not None:
        for index, name in enumerate(("red", "green", "blue")):
            vertices[name] = points.rgb[:, index]
    kinds = {"<f4": "float", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"comment frame {points.frame}, metres"]
    header.append(f"element vertex {len(points)}")
    header += [f"property {kinds[kind]} {name}" for name, kind in fields]
    header.append("end_header")
    write_bytes(Path(path), ("\n".join(header) + "\n").encode("ascii") + vertices.tobytes())


def read_ply(path: Path | str) -> PointCloud:
    """Read a PLY that `write_ply` wrote; `pixel` is -1, for the file does not hold it.

    Raises
    ------
    FormatError
        When the file is missing, of another layout or truncated.
    """
    path = Path(path)
    content = _content(path)
    head, mark, data = content.partition(b"end_header\n")
    lines = head.decode("ascii", "replace").split("\n")
    names = [line.split()[-1] for line in lines if line.startswith("property")]
    if not mark or lines[:2] != ["ply", "format binary_little_endian 1.0"] or names[:3] != ["x", "y", "z"]:
        raise FormatError(f"{path} is not a binary little-endian PLY of points x, y, z; write it with terrex")
    coloured = names == ["x", "y", "z", "red", "green", "blue"]
    if len(names) != 3 and not coloured:
        raise FormatError(f"{path} has the properties {', '.join(names)}; x, y, z and red, green, blue are possible")
    kinds = np.dtype([(name, "<f4" if name in "xyz" else "u1") for name in names])
    count = next((int(line.split()[2]) for line in lines if line.startswith("element vertex ")), 0)
    if len(data) != count * kinds.itemsize:
        raise FormatError(
            f"{path} holds {len(data)} bytes and {count} points need {count * kinds.itemsize}; copy it again"
        )
    vertices = np.frombuffer(data, kinds)
    frame = next((line.split()[2].rstrip(",") for line in lines if line.startswith("comment frame ")), "level")
    return PointCloud(
        xyz_m=np.column_stack([vertices[name] for name in "xyz"]).astype(np.float32),
        frame=frame,
        pixel=np.full(count, -1, np.int32),
        rgb=np.column_stack([vertices[name] for name in ("red", "green", "blue")]) if coloured else None,
    )
