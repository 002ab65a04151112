"""Attitude files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from modules.formats._text import number, read_mapping, read_text, write_text
from modules.formats.errors import FormatError
from modules.primitives.frames import angles_from_rotation
from modules.types import Attitude

ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
FIELDS = (*ANGLES, "sigma_deg", "quaternion")
LIMIT_DEG = {"roll_deg": 90.0, "pitch_deg": 90.0, "yaw_deg": 360.0, "sigma_deg": 90.0}
NORM_TOLERANCE = 0.01


def read_attitude(path: Path | str) -> Attitude:
    """Read the attitude of the body.

    Parameters
    ----------
    path : Path or str
        YAML with `roll_deg`, `pitch_deg`, `yaw_deg` (REP 103: positive pitch lowers the nose, positive roll lowers the
        right side; a missing one is 0, but one must be there), or `quaternion: {w, x, y, z}` of the same rotation; and
        optional `sigma_deg`.

    Returns
    -------
    Attitude

    Raises
    ------
    FormatError
        For a missing or malformed file, an angle out of range or a quaternion that is not of length 1.
    """
    path = Path(path)
    mapping = read_mapping(path, read_text(path, "attitude"), "attitude", FIELDS)
    sigma = number(path, mapping, "sigma_deg", 0.0)
    if sigma < 0.0:
        raise FormatError(f"{path}: sigma_deg is {sigma:g} and must not be negative")
    given = [name for name in ANGLES if name in mapping]
    if "quaternion" in mapping:
        if given:
            raise FormatError(f"{path} has both a quaternion and {given[0]}; keep one of them")
        roll, pitch, yaw = _angles_of_quaternion(path, mapping["quaternion"])
        _in_range(path, "roll_deg", math.degrees(roll))
        return Attitude(roll, pitch, yaw, math.radians(sigma))
    if not given:
        raise FormatError(f"{path} has neither {', '.join(ANGLES)} nor a quaternion; add them")
    roll, pitch, yaw = (math.radians(_in_range(path, name, number(path, mapping, name, 0.0))) for name in ANGLES)
    return Attitude(roll, pitch, yaw, math.radians(_in_range(path, "sigma_deg", sigma)))


def attitude_from_degrees(roll_deg: float, pitch_deg: float, yaw_deg: float, sigma_deg: float = 0.0) -> Attitude:
    """Return an attitude from degrees, with the checks of a file.

    Raises
    ------
    FormatError
        When an angle is out of range or not finite.
    """
    source = Path("the attitude given")
    values = (("roll_deg", roll_deg), ("pitch_deg", pitch_deg), ("yaw_deg", yaw_deg), ("sigma_deg", sigma_deg))
    roll, pitch, yaw, sigma = (math.radians(_in_range(source, name, value)) for name, value in values)
    return Attitude(roll, pitch, yaw, sigma)


def write_attitude(path: Path | str, attitude: Attitude) -> None:
    """Write an attitude as YAML that `read_attitude` reads back to 1e-12 rad."""
    values = (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad, attitude.sigma_rad)
    names = (*ANGLES, "sigma_deg")
    lines = [f"{name}: {math.degrees(value)!r}" for name, value in zip(names, values, strict=True)]
    write_text(Path(path), "\n".join(lines) + "\n")


def _in_range(path: Path, name: str, value: float) -> float:
    limit = LIMIT_DEG[name]
    if not abs(value) <= limit:
        raise FormatError(
            f"{path}: {name} is {value:g} deg, outside -{limit:g} to {limit:g} deg; "
            "check its unit and the order of angles"
        )
    return value


def _angles_of_quaternion(path: Path, value: object) -> tuple[float, float, float]:
    if not isinstance(value, Mapping) or set(value) != {"w", "x", "y", "z"}:
        raise FormatError(f"{path}: quaternion is {value!r} and must be a mapping with w, x, y and z")
    w, x, y, z = (number(path, value, name) for name in ("w", "x", "y", "z"))
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise FormatError(
            f"{path}: the quaternion has length {norm:.4g} and must have 1 within {NORM_TOLERANCE:g}; "
            "normalise it and check that no component is missing"
        )
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return angles_from_rotation(rotation)
