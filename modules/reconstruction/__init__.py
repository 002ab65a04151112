"""Reconstruction: from a disparity map to points and an elevation grid in a level frame.

Slots in order: frame, triangulate, gate, grid, fill, terrain.
"""

from modules.operator import Operator
from modules.reconstruction import (
    assume_level,
    compute_slope,
    fill_holes,
    gate_points,
    grid_elevation,
    level_by_attitude,
    level_by_ground_plane,
    triangulate_disparity,
)

SLOTS: tuple[str, ...] = ("frame", "triangulate", "gate", "grid", "fill", "terrain")

OPERATORS: tuple[Operator, ...] = (
    level_by_attitude.OPERATOR,
    level_by_ground_plane.OPERATOR,
    assume_level.OPERATOR,
    triangulate_disparity.OPERATOR,
    gate_points.OPERATOR,
    grid_elevation.OPERATOR,
    fill_holes.OPERATOR,
    compute_slope.OPERATOR,
)

__all__ = ["OPERATORS", "SLOTS"]
