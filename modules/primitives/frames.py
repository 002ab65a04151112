"""Rotations between the optical, body and level frames (ROS REP 103)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from modules.types import Attitude


def rotation_from_angles(roll_rad: float, pitch_rad: float, yaw_rad: float) -> NDArray[np.float64]:
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


def angles_from_rotation(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
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


def level_from_body(attitude: Attitude) -> NDArray[np.float64]:
    """Return the rotation (3, 3) that takes body coordinates to level coordinates."""
    return rotation_from_angles(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)


def roll_pitch_from_up(up_body: NDArray[np.float64]) -> tuple[float, float]:
    """Return the roll and pitch in radians at which the unit vector `up_body` (3,) points up."""
    pitch = math.asin(min(1.0, max(-1.0, -float(up_body[0]))))
    roll = math.atan2(float(up_body[1]), float(up_body[2]))
    return roll, pitch
