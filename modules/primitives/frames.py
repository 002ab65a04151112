"""Rotations between the frames: camera optical, body, level and local east-north-up.

Inside terrex everything follows ROS REP 103: optical x right, y down, z forward; body and level x forward, y left,
z up; east-north-up for a map with a compass. Aerospace data (body front-right-down, world north-east-down) are
converted on the way in:

=================  ==========================================  =========================================
angle              REP 103 (`rep103`)                          aerospace (`aerospace`)
=================  ==========================================  =========================================
roll               positive lowers the right side              the same
pitch              positive lowers the nose                    positive raises the nose
yaw                positive turns left; from east in a map     heading, positive turns right, from north
=================  ==========================================  =========================================

An inertial unit that is built in upright (`euroc`: x up, y right, z forward, as that of the EuRoC sequences, in a world
whose z points up) states rotations, not these angles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from modules.types import Attitude, Mount

Matrix: TypeAlias = NDArray[np.float64]
Convention: TypeAlias = Literal["rep103", "aerospace", "euroc"]

STANDARD_GRAVITY_MPS2 = 9.80665  # ISO 80000-3
ORTHONORMAL_TOLERANCE = 1e-3
FLU_FROM_FRD: Matrix = np.diag([1.0, -1.0, -1.0])
FLU_FROM_BODY: Mapping[Convention, Matrix] = MappingProxyType(
    {
        "rep103": np.eye(3),
        "aerospace": FLU_FROM_FRD,
        "euroc": np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]),
    }
)
"""Rotations that take the body axes of a convention to forward, left, up."""
ENU_FROM_NED: Matrix = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def rotation_from_angles(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Matrix:
    """Return `Rz(yaw) Ry(pitch) Rx(roll)`, float64 (3, 3).

    Positive roll lowers the right side, positive pitch lowers the nose, positive yaw turns left.

    References
    ----------
    T. Foote and M. Purvis, "Standard Units of Measure and Coordinate Conventions", ROS REP 103, 2010.

    Examples
    --------
    >>> nose = rotation_from_angles(0.0, math.radians(30.0), 0.0) @ [1.0, 0.0, 0.0]
    >>> bool(nose[2] < 0)
    True
    """
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def angles_from_rotation(rotation: Matrix) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in radians of a rotation (3, 3), the inverse of `rotation_from_angles`.

    At a pitch of +-90 degrees roll and yaw are not separate; roll is then 0.
    """
    sin_pitch = min(1.0, max(-1.0, -float(rotation[2, 0])))
    pitch = math.asin(sin_pitch)
    if abs(sin_pitch) > 1.0 - 1e-12:
        return 0.0, pitch, math.atan2(-float(rotation[0, 1]), float(rotation[1, 1]))
    roll = math.atan2(float(rotation[2, 1]), float(rotation[2, 2]))
    yaw = math.atan2(float(rotation[1, 0]), float(rotation[0, 0]))
    return roll, pitch, yaw


def rotation_from_quaternion(w: float, x: float, y: float, z: float) -> Matrix:
    """Return the rotation (3, 3) of a quaternion, whose length does not matter."""
    from scipy.spatial.transform import Rotation  # a third of a second to import

    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())


def rotation_problem(matrix: Matrix) -> str | None:
    """Say why a matrix (3, 3) is no rotation, or return None."""
    error = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if error > ORTHONORMAL_TOLERANCE:
        return (
            f"it is no rotation (R R^T differs from 1 by {error:.2g}, limit {ORTHONORMAL_TOLERANCE:g}); "
            "its rows must be orthogonal and of length 1: check its digits and that it holds no scale"
        )
    if np.linalg.det(matrix) < 0.0:
        return (
            "it is left-handed (determinant -1, must be +1): it mirrors; "
            "one axis has the wrong sign or two rows are exchanged"
        )
    return None


def nearest_rotation(matrix: Matrix) -> Matrix:
    """Return the rotation nearest to a matrix (3, 3) that has rounding errors; a rotation to 1e-9 is kept as it is."""
    if float(np.abs(matrix @ matrix.T - np.eye(3)).max()) < 1e-9:
        return matrix
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)


def level_from_body(attitude: Attitude) -> Matrix:
    """Return the rotation (3, 3) that takes body coordinates to level coordinates."""
    return rotation_from_angles(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)


def mount_in_flu(mount: Mount, convention: Convention) -> Mount:
    """Return a mount whose body axes are those of a convention as one whose body is forward, left, up."""
    flu_from_body = FLU_FROM_BODY[convention]
    x, y, z = (float(value) for value in flu_from_body @ np.asarray(mount.translation_m))
    return replace(mount, rotation=flu_from_body @ mount.rotation, translation_m=(x, y, z))


def enu_from_level(heading_rad: float) -> Matrix:
    """Return the rotation (3, 3) from a level frame to east-north-up.

    Parameters
    ----------
    heading_rad : float
        Compass heading of the level frame's x axis, clockwise from north, radians.

    Examples
    --------
    Level x points east at a heading of 90 degrees, and level y, to its left, points north:

    >>> enu_from_level(math.radians(90.0)).round(9) + 0.0
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 1.]])
    """
    return rotation_from_angles(0.0, 0.0, math.pi / 2 - heading_rad)


def rep103_from_aerospace(ned_from_frd: Matrix) -> Matrix:
    """Turn an aerospace attitude (north-east-down from front-right-down) into REP 103 (east-north-up from body).

    Examples
    --------
    Level, nose to the east (heading 90 degrees): in east-north-up the body is not turned at all.

    >>> rep103_from_aerospace(rotation_from_angles(0.0, 0.0, math.radians(90.0))).round(9) + 0.0
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 1.]])
    """
    return ENU_FROM_NED @ ned_from_frd @ FLU_FROM_FRD.T


def roll_pitch_from_up(up_body: Matrix) -> tuple[float, float]:
    """Return the roll and pitch in radians at which the unit vector `up_body` (3,) points up."""
    pitch = math.asin(min(1.0, max(-1.0, -float(up_body[0]))))
    roll = math.atan2(float(up_body[1]), float(up_body[2]))
    return roll, pitch


def mount_from_angles(
    roll_rad: float, pitch_rad: float, yaw_rad: float, translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Mount:
    """Return the mount of a camera turned by these angles (REP 103) from looking forward."""
    return Mount(rotation_from_angles(roll_rad, pitch_rad, yaw_rad) @ Mount().rotation, translation_m)


def mount_from_aerospace(rotation: Matrix, translation_m: tuple[float, float, float]) -> Mount:
    """Return the mount of a camera given in a body frame with axes front-right-down: `p_frd = R p_optical + t`."""
    x, y, z = (float(value) for value in FLU_FROM_FRD @ np.asarray(translation_m))
    return Mount(FLU_FROM_FRD @ rotation, (x, y, z))


def mount_angles(mount: Mount) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in radians of the camera against looking forward."""
    return angles_from_rotation(mount.rotation @ Mount().rotation.T)


def rectified_mount(mount: Mount, left_rotation: Matrix) -> Mount:
    """Return the mount of the rectified left camera: `p_rectified = left_rotation @ p_optical`."""
    return Mount(mount.rotation @ left_rotation.T, mount.translation_m)
