"""Point clouds: PLY, PCD and LAS/LAZ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import write_bytes
from modules.formats.errors import FormatError
from modules.formats.images import _content
from modules.types import PointCloud

COLOURS = ("red", "green", "blue")
COVARIANCE = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
LAS_STEP_M = 1e-4  # coordinates of a LAS file are whole multiples of this
LAS_RGB = 257  # 8 bit to the 16 bit of LAS


def write_ply(path: Path | str, points: PointCloud) -> None:
    """Write binary little-endian PLY: x, y, z float (m), red, green, blue uchar, cov_xx ... cov_zz float (m^2).

    Colours and covariances are left out where the cloud has none.
    """
    fields: list[tuple[str, str]] = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    columns: list[tuple[tuple[str, ...], NDArray[np.generic]]] = [(("x", "y", "z"), points.xyz_m)]
    if points.rgb is not None:
        fields += [(name, "u1") for name in COLOURS]
        columns.append((COLOURS, points.rgb))
    if points.covariance_m2 is not None:
        fields += [(name, "<f4") for name in COVARIANCE]
        columns.append((COVARIANCE, points.covariance_m2))
    vertices = np.empty(len(points), dtype=fields)
    for names, values in columns:
        for index, name in enumerate(names):
            vertices[name] = values[:, index]
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
    coloured, uncertain = names[3:6] == [*COLOURS], names[-6:] == [*COVARIANCE]
    if len(names) != 3 + 3 * coloured + 6 * uncertain:
        possible = "x, y, z, red, green, blue and cov_xx to cov_zz"
        raise FormatError(f"{path} has the properties {', '.join(names)}; {possible} are possible")
    kinds = np.dtype([(name, "u1" if name in COLOURS else "<f4") for name in names])
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
        rgb=np.column_stack([vertices[name] for name in COLOURS]) if coloured else None,
        covariance_m2=np.column_stack([vertices[name] for name in COVARIANCE]) if uncertain else None,
    )


def write_pcd(path: Path | str, points: PointCloud) -> None:
    """Write a binary PCD 0.7 of the Point Cloud Library: x, y, z (m), packed rgb, and sigma_z (m) where it is known."""
    fields: list[tuple[str, str, str]] = [("x", "<f4", "F"), ("y", "<f4", "F"), ("z", "<f4", "F")]
    if points.rgb is not None:
        fields.append(("rgb", "<u4", "U"))
    if points.covariance_m2 is not None:
        fields.append(("sigma_z", "<f4", "F"))
    rows = np.empty(len(points), dtype=[(name, kind) for name, kind, _ in fields])
    for index, name in enumerate("xyz"):
        rows[name] = points.xyz_m[:, index]
    if points.rgb is not None:
        red, green, blue = (points.rgb[:, index].astype(np.uint32) for index in range(3))
        rows["rgb"] = (red << 16) | (green << 8) | blue
    if points.covariance_m2 is not None:
        rows["sigma_z"] = np.sqrt(points.covariance_m2[:, 5])
    header = [
        f"# .PCD v0.7 - points in the frame {points.frame}, metres",
        "VERSION 0.7",
        "FIELDS " + " ".join(name for name, _, _ in fields),
        "SIZE " + " ".join("4" for _ in fields),
        "TYPE " + " ".join(letter for _, _, letter in fields),
        "COUNT " + " ".join("1" for _ in fields),
        f"WIDTH {len(points)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(points)}",
        "DATA binary",
    ]
    write_bytes(Path(path), ("\n".join(header) + "\n").encode("ascii") + rows.tobytes())


def write_las(path: Path | str, points: PointCloud) -> None:
    """Write LAS 1.4, or LAZ by the suffix, with colours and the extra dimension `sigma_z` (m); steps of 0.1 mm.

    Raises
    ------
    FormatError
        When the extra `geo` is not installed, or the path cannot be written.
    """
    path = Path(path)
    try:
        import laspy
    except ImportError as error:
        raise FormatError(f"{path} needs laspy, which is not installed; install terrex[geo]") from error
    header = laspy.LasHeader(version="1.4", point_format=7 if points.rgb is not None else 6)
    header.scales = np.full(3, LAS_STEP_M)
    xyz = points.xyz_m.astype(np.float64)
    header.offsets = np.floor(xyz.min(axis=0)) if len(points) else np.zeros(3)
    if points.covariance_m2 is not None:
        header.add_extra_dim(laspy.ExtraBytesParams("sigma_z", np.float32, "standard deviation of z, m"))
    las = laspy.LasData(header)
    las.x, las.y, las.z = (xyz[:, axis] for axis in range(3))
    if points.rgb is not None:
        for index, name in enumerate(COLOURS):
            setattr(las, name, points.rgb[:, index].astype(np.uint16) * LAS_RGB)
    if points.covariance_m2 is not None:
        las["sigma_z"] = np.sqrt(points.covariance_m2[:, 5])
    try:
        las.write(str(path))
    except OSError as error:
        raise FormatError(f"{path} cannot be written ({error.strerror}); check the folder") from error
