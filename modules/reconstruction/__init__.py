"""Reconstruction: from a disparity map to points and an elevation grid in a level frame.

Slots in order: frame, triangulate, gate, outliers, grid, fill, terrain, sight, traversability.
"""

from modules.operator import Operator
from modules.reconstruction import (
    assess_traversability,
    assume_level,
    compute_slope,
    fill_holes,
    gate_points,
    grid_elevation,
    level_by_attitude,
    level_by_ground_plane,
    remove_radius_outliers,
    remove_statistical_outliers,
    trace_sight,
    triangulate_disparity,
)

SLOTS: tuple[str, ...] = (
    "frame", "triangulate", "gate", "outliers", "grid", "fill", "terrain", "sight", "traversability"
)  # fmt: skip

OPERATORS: tuple[Operator, ...] = (
    level_by_attitude.OPERATOR,
    level_by_ground_plane.OPERATOR,
    assume_level.OPERATOR,
    triangulate_disparity.OPERATOR,
    gate_points.OPERATOR,
    remove_statistical_outliers.OPERATOR,
    remove_radius_outliers.OPERATOR,
    grid_elevation.OPERATOR,
    fill_holes.OPERATOR,
    compute_slope.OPERATOR,
    trace_sight.OPERATOR,
    assess_traversability.OPERATOR,
)

__all__ = ["OPERATORS", "SLOTS"]
