"""Synthetic terrain with known truth, and faults of cameras; writes no files."""

from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right, scale_distortion
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.simulation.terrain import RenderedPair, TerrainParams, render_terrain

__all__ = [
    "REFERENCE_DISTORTIONS",
    "RenderedPair",
    "SensorParams",
    "TerrainParams",
    "apply_sensor",
    "distort_right",
    "render_terrain",
    "scale_distortion",
]
