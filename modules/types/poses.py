"""Attitudes, poses and mounts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Attitude:
    """Attitude of the body: `p_level = Rz(yaw) Ry(pitch) Rx(roll) p_body`, radians, REP 103."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    sigma_rad: float = 0.0  # standard deviation of roll and pitch


@dataclass(frozen=True)
class Pose:
    """Where the body stands in a map: `p_map = Rz(yaw) Ry(pitch) Rx(roll) p_body + translation_m`.

    Attributes
    ----------
    attitude : Attitude
    translation_m : (float, float, float)
        The body's origin in the level frame of the map, or east, north, up where yaw counts from east.
    sigma_m : float
        Standard deviation of each component of the translation, m.
    """

    attitude: Attitude = field(default_factory=Attitude)
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sigma_m: float = 0.0


@dataclass(frozen=True)
class Mount:
    """Where the left camera sits: `p_body = rotation @ p_optical + translation_m`.

    The default looks forward along body x from the origin of the body frame.
    """

    rotation: NDArray[np.float64] = field(
        default_factory=lambda: np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    )
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
