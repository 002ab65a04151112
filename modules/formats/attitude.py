"""Attitude files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import number, numbers, read_mapping, read_text, write_text
from modules.formats.errors import FormatError
from modules.primitives.frames import (
    FLU_FROM_BODY,
    STANDARD_GRAVITY_MPS2,
    Convention,
    angles_from_rotation,
    nearest_rotation,
    rep103_from_aerospace,
    roll_pitch_from_up,
    rotation_from_quaternion,
    rotation_problem,
)
from modules.types import Attitude

ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
RADIANS = ("roll_rad", "pitch_rad", "yaw_rad")
FORMS = ("quaternion", "rotation_matrix", "accelerometer_mps2")
FIELDS = (*ANGLES, *RADIANS, *FORMS, "convention", "sigma_deg")
LIMIT_DEG = {"roll_deg": 90.0, "pitch_deg": 90.0, "yaw_deg": 360.0, "sigma_deg": 90.0}
NORM_TOLERANCE = 0.01
GRAVITY_TOLERANCE = 0.05  # of a body at rest, with the bias of a cheap accelerometer
CONVENTIONS: tuple[Convention, ...] = ("rep103", "aerospace", "euroc")


def read_attitude(path: Path | str) -> Attitude:
    """Read the attitude of the body.

    Parameters
    ----------
    path : Path or str
        YAML with one of

        - `roll_deg`, `pitch_deg`, `yaw_deg` or `roll_rad`, ...; a missing one is 0, but one must be there;
        - `quaternion: {w, x, y, z}`, or `rotation_matrix`, rows of R, of `p_level = R p_body`;
        - `accelerometer_mps2: [x, y, z]` of a body at rest, which gives roll and pitch alone: the reading points up;

        optional `sigma_deg`, and `convention`: `rep103` (the default: body front-left-up, positive pitch lowers the
        nose, positive roll lowers the right side, positive yaw turns left) or `aerospace` (body front-right-down,
        world north-east-down: positive pitch raises the nose, yaw is the heading, clockwise from north; the level frame
        is then east-north-up, unless no heading is given), or `euroc` (an inertial unit with x up, y right, z forward
        in a world whose z points up; no angles).

    Returns
    -------
    Attitude

    Raises
    ------
    FormatError
        For a missing or malformed file, an angle out of range or in the wrong unit, a quaternion that is not of length
        1, a matrix that is no rotation, an accelerometer that does not measure gravity.
    """
    path = Path(path)
    mapping = read_mapping(path, read_text(path, "attitude"), "attitude", FIELDS)
    sigma = number(path, mapping, "sigma_deg", 0.0)
    if sigma < 0.0:
        raise FormatError(f"{path}: sigma_deg is {sigma:g} and must not be negative")
    convention = mapping.get("convention", "rep103")
    if convention not in CONVENTIONS:
        raise FormatError(f"{path}: convention is {convention!r}; known are {', '.join(CONVENTIONS)}")
    given = [name for name in FORMS if name in mapping]
    given += [names[0] for names in ([n for n in group if n in mapping] for group in (ANGLES, RADIANS)) if names]
    if len(given) > 1:
        raise FormatError(f"{path} has both a {given[0]} and {given[1]}; keep one of them")
    if not given:
        raise FormatError(
            f"{path} has neither {', '.join(ANGLES)} nor a quaternion, a rotation_matrix or accelerometer_mps2; add one"
        )
    form = given[0]
    if form == "accelerometer_mps2":
        return attitude_from_gravity(path, np.array(numbers(path, form, mapping[form], 3)), convention, sigma)
    if form in FORMS:
        rotation = (_of_quaternion if form == "quaternion" else _of_matrix)(path, mapping[form])
        return attitude_from_rotation(path, rotation, convention, sigma)
    names = RADIANS if form in RADIANS else ANGLES
    roll, pitch, yaw = (in_degrees(path, name, number(path, mapping, name, 0.0)) for name in names)
    heading = yaw if names[2] in mapping else None
    return attitude_from_degrees(roll, pitch, heading, sigma, convention=convention, source=path)


def convention_of(path: Path | str) -> Convention:
    """Return the convention that an attitude file states, which `read_attitude` has accepted."""
    mapping = read_mapping(Path(path), read_text(Path(path), "attitude"), "attitude", FIELDS)
    return next(name for name in CONVENTIONS if name == mapping.get("convention", "rep103"))


def attitude_from_degrees(
    roll_deg: float,
    pitch_deg: float,
    yaw_deg: float | None = None,
    sigma_deg: float = 0.0,
    *,
    convention: Convention = "rep103",
    source: object = "the attitude given",
) -> Attitude:
    """Return an attitude from degrees, with the checks of a file.

    Without a yaw the level frame looks ahead; an aerospace yaw is a heading, and the level frame is east-north-up.

    Raises
    ------
    FormatError
        When an angle is out of range or not finite.
    """
    if convention == "euroc":
        raise FormatError(
            f"{source}: roll, pitch and yaw have no meaning for the convention 'euroc'; "
            "give a quaternion, a rotation matrix or the accelerometer"
        )
    yaw = 0.0 if yaw_deg is None else yaw_deg
    values = (("roll_deg", roll_deg), ("pitch_deg", pitch_deg), ("yaw_deg", yaw), ("sigma_deg", sigma_deg))
    roll, pitch, yaw, sigma = (math.radians(_in_range(source, name, value)) for name, value in values)
    if convention == "aerospace":
        return Attitude(roll, -pitch, 0.0 if yaw_deg is None else math.pi / 2 - yaw, sigma)
    return Attitude(roll, pitch, yaw, sigma)


def attitude_from_rotation(
    source: object, rotation: NDArray[np.float64], convention: Convention = "rep103", sigma_deg: float = 0.0
) -> Attitude:
    """Return an attitude from the rotation (3, 3) from body to world in the axes of `convention`.

    Raises
    ------
    FormatError
        When the body lies on its side or back, which no vehicle on its wheels does.
    """
    if convention == "aerospace":
        rotation = rep103_from_aerospace(rotation)
    else:
        rotation = rotation @ FLU_FROM_BODY[convention].T
    if rotation[2, 2] < 0.0:
        away = math.degrees(math.acos(max(-1.0, float(rotation[2, 2]))))
        raise FormatError(
            f"{source}: the body lies on its side or back, its up axis {away:.0f} deg from up, by the convention "
            f"{convention!r}; if it has other axes, name them: {', '.join(n for n in CONVENTIONS if n != convention)} "
            "(--convention, or convention in the file); otherwise check the order of the components"
        )
    roll, pitch, yaw = angles_from_rotation(rotation)
    return Attitude(roll, pitch, yaw, math.radians(sigma_deg))


def attitude_from_gravity(
    source: object, reading_mps2: NDArray[np.float64], convention: Convention = "rep103", sigma_deg: float = 0.0
) -> Attitude:
    """Return roll and pitch from an accelerometer (3,) at rest, m/s^2, whose reading points up.

    Raises
    ------
    FormatError
        When the length is not that of gravity (in motion, or in g), or the reading points down.
    """
    length = float(np.linalg.norm(reading_mps2))
    if abs(length / STANDARD_GRAVITY_MPS2 - 1.0) > GRAVITY_TOLERANCE:
        in_g = abs(length - 1.0) < GRAVITY_TOLERANCE
        remedy = "it is in g: multiply by 9.80665" if in_g else "take it at rest, in m/s^2, without bias"
        raise FormatError(
            f"{source}: the accelerometer reads {length:.4g} m/s^2 and must read {STANDARD_GRAVITY_MPS2:g} within "
            f"{GRAVITY_TOLERANCE:.0%}; {remedy}"
        )
    up = reading_mps2 / length
    up = FLU_FROM_BODY[convention] @ up
    if up[2] < 0.0:
        raise FormatError(
            f"{source}: the accelerometer reads {up[2] * length:.3g} m/s^2 along the body's up axis and must read "
            "above 0: at rest it points up, against gravity; change its sign, or name the convention of its axes"
        )
    roll, pitch = roll_pitch_from_up(up)
    return Attitude(roll, pitch, 0.0, math.radians(sigma_deg))


def quaternion_rotation(source: object, w: float, x: float, y: float, z: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of a quaternion that must be of length 1.

    Raises
    ------
    FormatError
    """
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(norm - 1.0) <= NORM_TOLERANCE:
        raise FormatError(
            f"{source}: the quaternion has length {norm:.4g} and must have 1 within {NORM_TOLERANCE:g}; "
            "normalise it and check that no component is missing"
        )
    return rotation_from_quaternion(w, x, y, z)


def write_attitude(path: Path | str, attitude: Attitude) -> None:
    """Write an attitude as YAML that `read_attitude` reads back to 1e-12 rad."""
    values = (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad, attitude.sigma_rad)
    names = (*ANGLES, "sigma_deg")
    lines = [f"{name}: {math.degrees(value)!r}" for name, value in zip(names, values, strict=True)]
    write_text(Path(path), "\n".join(lines) + "\n")


def _in_range(source: object, name: str, value: float) -> float:
    limit = LIMIT_DEG[name]
    if not abs(value) <= limit:
        raise FormatError(
            f"{source}: {name} is {value:g} deg, outside -{limit:g} to {limit:g} deg; "
            "check its unit and the order of angles"
        )
    return value


def in_degrees(source: object, name: str, value: float) -> float:
    """Return an angle of a field in degrees; a field whose name ends in `_rad` is converted and checked."""
    if name not in RADIANS:
        return value
    if not abs(value) <= 2.0 * math.pi:
        raise FormatError(
            f"{source}: {name} is {value:g}, beyond 2 pi; it is in degrees: call it {name.replace('_rad', '_deg')}"
        )
    return math.degrees(value)


def _of_quaternion(path: Path, value: object) -> NDArray[np.float64]:
    if not isinstance(value, Mapping) or set(value) != {"w", "x", "y", "z"}:
        raise FormatError(f"{path}: quaternion is {value!r} and must be a mapping with w, x, y and z")
    return quaternion_rotation(path, *(number(path, value, name) for name in ("w", "x", "y", "z")))


def _of_matrix(path: Path, value: object) -> NDArray[np.float64]:
    if not isinstance(value, list) or len(value) != 3:
        raise FormatError(f"{path}: rotation_matrix is {value!r} and must be a list of 3 rows of 3 numbers")
    matrix = np.array([numbers(path, "rotation_matrix", row, 3) for row in value])
    problem = rotation_problem(matrix)
    if problem:
        raise FormatError(f"{path}: rotation_matrix: {problem}")
    return nearest_rotation(matrix)
