"""Calibration files: Middlebury calib.txt and YAML."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import number, numbers, read_mapping, read_text, write_text
from modules.formats.errors import FormatError
from modules.primitives.frames import angles_from_rotation, rotation_from_angles
from modules.types import Calibration, Mount

MIN_FOCAL_PX = 50.0  # a lens of 3 to 50 mm read as pixels falls below
MIN_FOCAL_PER_WIDTH = 0.1  # a field of view of 157 degrees
MAX_FOCAL_PER_WIDTH = 50.0
MAX_BASELINE_M = 100.0  # more is a baseline in mm
FIELDS = ("focal_px", "cx_px", "cy_px", "baseline_m", "width_px", "height_px", "doffs_px", "mount")
MOUNT_FIELDS = ("rotation_matrix", "roll_deg", "pitch_deg", "yaw_deg", "translation_m")
ORTHONORMAL_TOLERANCE = 1e-3


def read_calibration(path: Path | str) -> tuple[Calibration, Mount | None]:
    """Read a calibration.

    Parameters
    ----------
    path : Path or str
        Middlebury `calib.txt` (baseline in mm) or YAML with `focal_px`, `cx_px`, `cy_px`, `baseline_m`, `width_px`,
        `height_px`, optional `doffs_px` and `mount`: `roll_deg`, `pitch_deg`, `yaw_deg` of the camera against looking
        forward (positive pitch looks down), or `rotation_matrix`, rows of `p_body = R p_optical`; and `translation_m`,
        the left camera in body axes.

    Returns
    -------
    Calibration, Mount or None

    Raises
    ------
    FormatError
        For a missing or malformed file and for values that cannot be: baseline not positive or in mm, focal length
        not positive or in mm, sizes not positive, a mount that is no rotation.
    """
    path = Path(path)
    text = read_text(path, "calibration")
    if re.search(r"^\s*cam0\s*=", text, re.MULTILINE):
        return _middlebury(path, text), None
    mapping = read_mapping(path, text, "calibration", FIELDS)
    calibration = Calibration(
        focal_px=number(path, mapping, "focal_px"),
        cx_px=number(path, mapping, "cx_px"),
        cy_px=number(path, mapping, "cy_px"),
        baseline_m=number(path, mapping, "baseline_m"),
        width_px=_whole(path, "width_px", number(path, mapping, "width_px")),
        height_px=_whole(path, "height_px", number(path, mapping, "height_px")),
        doffs_px=number(path, mapping, "doffs_px", 0.0),
    )
    _check(path, calibration)
    mount = mapping.get("mount")
    return calibration, None if mount is None else _mount(path, mount)


def write_calibration(path: Path | str, calibration: Calibration, mount: Mount | None = None) -> None:
    """Write a calibration, and the mount if given, as YAML that `read_calibration` reads back exactly."""
    lines = [f"{name}: {getattr(calibration, name)!r}" for name in FIELDS if name != "mount"]
    if mount is not None:
        lines += ["mount:", "  rotation_matrix:"]
        lines += [f"    - [{', '.join(repr(float(value)) for value in row)}]" for row in mount.rotation]
        lines.append(f"  translation_m: [{', '.join(repr(float(value)) for value in mount.translation_m)}]")
    write_text(Path(path), "\n".join(lines) + "\n")


def check_calibration(calibration: Calibration, shape: tuple[int, int]) -> None:
    """Check that a calibration was made for images of `shape` (rows, columns).

    Raises
    ------
    FormatError
        When the sizes differ, with the scale if one explains the difference.
    """
    rows, columns = shape
    if (calibration.height_px, calibration.width_px) == (rows, columns):
        return
    scale_x, scale_y = columns / calibration.width_px, rows / calibration.height_px
    remedy = "use the calibration of this camera and crop"
    if abs(scale_x / scale_y - 1.0) < 0.01:
        remedy = f"the images seem scaled by {scale_x:.3g}: scale focal length, principal point and doffs likewise"
    raise FormatError(
        f"the calibration is for {calibration.width_px}x{calibration.height_px} px and the images are "
        f"{columns}x{rows} px; {remedy}"
    )


def mount_from_angles(
    roll_rad: float, pitch_rad: float, yaw_rad: float, translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Mount:
    """Return the mount of a camera turned by these angles (REP 103) from looking forward."""
    return Mount(rotation_from_angles(roll_rad, pitch_rad, yaw_rad) @ Mount().rotation, translation_m)


def mount_angles(mount: Mount) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in radians of the camera against looking forward."""
    return angles_from_rotation(mount.rotation @ Mount().rotation.T)


def _middlebury(path: Path, text: str) -> Calibration:
    values: dict[str, object] = {}
    for line in text.splitlines():
        name, equals, value = line.partition("=")
        if equals:
            values[name.strip()] = value.strip()
    camera = _camera_matrix(path, "cam0", str(values["cam0"]))
    doffs = number(path, values, "doffs", 0.0)
    if "doffs" not in values and "cam1" in values:
        doffs = float(_camera_matrix(path, "cam1", str(values["cam1"]))[0, 2] - camera[0, 2])
    calibration = Calibration(
        focal_px=float(camera[0, 0]),
        cx_px=float(camera[0, 2]),
        cy_px=float(camera[1, 2]),
        baseline_m=number(path, values, "baseline") / 1000.0,
        width_px=_whole(path, "width", number(path, values, "width")),
        height_px=_whole(path, "height", number(path, values, "height")),
        doffs_px=doffs,
    )
    _check(path, calibration)
    return calibration


def _camera_matrix(path: Path, name: str, text: str) -> NDArray[np.float64]:
    try:
        entries = [float(entry) for entry in text.strip("[] \t").replace(";", " ").replace(",", " ").split()]
    except ValueError as error:
        raise FormatError(f"{path}: {name} is {text!r} and must be [f 0 cx; 0 f cy; 0 0 1]") from error
    if len(entries) != 9 or not np.isfinite(entries).all():
        raise FormatError(f"{path}: {name} is {text!r} and must hold nine finite numbers, [f 0 cx; 0 f cy; 0 0 1]")
    return np.array(entries).reshape(3, 3)


def _whole(path: Path, key: str, value: float) -> int:
    if value != round(value):
        raise FormatError(f"{path}: {key} is {value:g} and must be a whole number of px")
    return round(value)


def _check(path: Path, calibration: Calibration) -> None:
    """Report all impossible values at once."""
    c = calibration
    problems = []
    if c.width_px <= 0 or c.height_px <= 0:
        problems.append(f"the size is {c.width_px}x{c.height_px} px and must be positive; give that of the images")
    if c.baseline_m <= 0.0:
        problems.append(f"the baseline is {c.baseline_m:g} m and must be above 0; swap the images if it is negative")
    elif c.baseline_m > MAX_BASELINE_M:
        problems.append(f"the baseline is {c.baseline_m:g} m, above {MAX_BASELINE_M:g} m; is it in mm? divide by 1000")
    if c.focal_px <= 0.0:
        problems.append(f"the focal length is {c.focal_px:g} px and must be above 0")
    elif c.focal_px < max(MIN_FOCAL_PX, MIN_FOCAL_PER_WIDTH * c.width_px):
        limit = max(MIN_FOCAL_PX, MIN_FOCAL_PER_WIDTH * c.width_px)
        problems.append(
            f"the focal length is {c.focal_px:g} px, below {limit:g} px for a width of {c.width_px} px; "
            "is it in mm? divide by the pixel pitch in mm"
        )
    elif c.width_px > 0 and c.focal_px > MAX_FOCAL_PER_WIDTH * c.width_px:
        problems.append(
            f"the focal length is {c.focal_px:g} px, above {MAX_FOCAL_PER_WIDTH * c.width_px:g} px for a width of "
            f"{c.width_px} px; give it in px of these images"
        )
    if problems:
        raise FormatError(f"{path}: " + ". ".join(problems))


def _mount(path: Path, value: object) -> Mount:
    if not isinstance(value, Mapping):
        raise FormatError(f"{path}: mount is {value!r} and must be a mapping with {', '.join(MOUNT_FIELDS)}")
    unknown = [str(key) for key in value if key not in MOUNT_FIELDS]
    if unknown:
        raise FormatError(f"{path}: mount has unknown field '{unknown[0]}'; possible are {', '.join(MOUNT_FIELDS)}")
    x, y, z = numbers(path, "translation_m", value.get("translation_m", [0.0, 0.0, 0.0]), 3)
    if "rotation_matrix" not in value:
        roll, pitch, yaw = (np.radians(number(path, value, f"{name}_deg", 0.0)) for name in ("roll", "pitch", "yaw"))
        return mount_from_angles(float(roll), float(pitch), float(yaw), (x, y, z))
    if any(name in value for name in MOUNT_FIELDS[1:4]):
        raise FormatError(f"{path}: mount has both rotation_matrix and angles; keep one")
    rows = value["rotation_matrix"]
    if not isinstance(rows, list) or len(rows) != 3:
        raise FormatError(f"{path}: rotation_matrix is {rows!r} and must be a list of 3 rows of 3 numbers")
    rotation = np.array([numbers(path, "rotation_matrix", row, 3) for row in rows])
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > ORTHONORMAL_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise FormatError(
            f"{path}: rotation_matrix is no rotation (R R^T differs from 1 by {error:.2g}, limit "
            f"{ORTHONORMAL_TOLERANCE:g}; determinant {np.linalg.det(rotation):.3g}, must be +1); "
            "check its rows and signs"
        )
    return Mount(rotation, (x, y, z))
