"""Facts about a reconstructed terrain."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from modules.primitives.planes import robust_plane
from modules.probe import FactModel, Probe, quantity
from modules.types import ElevationMap, Mask, Scene

NEAR_M = 6.0  # where a rover plans its next metres
PLANE_TOLERANCE_M = 0.15
PLANE_POINTS = 20_000


class TerrainQuality(FactModel):
    """How complete, how flat and how plausible the terrain is."""

    template: ClassVar[str] = "terrain_quality"

    point_count: int = quantity("Points after gating", ge=0)
    kept_fraction: float = quantity("Points kept of the pixels that have a disparity", ge=0.0, le=1.0, resolution=0.001)
    behind_camera_fraction: float = quantity(
        "Matched pixels whose disparity + doffs is not positive, so that they would lie behind the camera",
        ge=0.0,
        le=1.0,
        resolution=0.001,
    )
    median_range_m: float | None = quantity(
        "Median horizontal distance of the points", unit="m", ge=0.0, resolution=0.01, default=None
    )
    covered_cells: int | None = quantity("Measured cells, filled ones not counted", ge=0, default=None)
    covered_m2: float | None = quantity("Measured area", unit="m2", ge=0.0, resolution=0.01, default=None)
    extent_m: float | None = quantity(
        "Longer side of the elevation grid", unit="m", ge=0.0, resolution=0.01, default=None
    )
    near_density: float | None = quantity(
        f"Known fraction of the cells within {NEAR_M:g} m that lie in the field of view",
        ge=0.0,
        le=1.0,
        resolution=0.001,
        default=None,
    )
    filled_fraction: float | None = quantity(
        "Filled cells of the known cells", ge=0.0, le=1.0, resolution=0.001, default=None
    )
    median_sigma_m: float | None = quantity(
        "Median elevation uncertainty of the measured cells", unit="m", ge=0.0, resolution=0.0001, default=None
    )
    plane_residual_m: float | None = quantity(
        "Root mean square height about the dominant plane, of the points on it",
        unit="m",
        ge=0.0,
        resolution=0.0001,
        default=None,
    )
    plane_inlier_fraction: float | None = quantity(
        f"Points within {PLANE_TOLERANCE_M:g} m, or two sigma, of the dominant plane",
        ge=0.0,
        le=1.0,
        resolution=0.001,
        default=None,
    )
    plane_tilt_deg: float | None = quantity(
        "Tilt of the dominant plane against the level frame", unit="deg", ge=0.0, le=90.0, resolution=0.01, default=None
    )
    median_slope_deg: float | None = quantity(
        "Median slope of the cells", unit="deg", ge=0.0, le=90.0, resolution=0.01, default=None
    )
    attitude_sigma_deg: float | None = quantity(
        "Standard deviation of roll and pitch used", unit="deg", ge=0.0, resolution=0.001, default=None
    )


def measure_terrain_quality(scene: Scene) -> list[TerrainQuality]:
    """Measure the points and the elevation grid of a scene.

    Parameters
    ----------
    scene : Scene
        After reconstruction; points, grid and layers may be missing, and the fields that need them are then None.

    Returns
    -------
    list of TerrainQuality
        One fact, or none when nothing was triangulated.
    """
    points = scene.points
    if points is None:
        return []
    values: dict[str, float | int] = {"point_count": len(points), "behind_camera_fraction": 0.0, "kept_fraction": 0.0}
    matched = int(np.count_nonzero(scene.disparity.valid))
    beyond = scene.rejected.get("behind_camera", 0)
    if matched:
        values["kept_fraction"] = min(1.0, len(points) / matched)
        values["behind_camera_fraction"] = min(1.0, beyond / matched)
    if len(points):
        xyz = points.xyz_m.astype(np.float64)
        values["median_range_m"] = float(np.median(np.hypot(xyz[:, 0], xyz[:, 1])))
        values.update(_plane(scene, xyz))
    if scene.attitude is not None:
        values["attitude_sigma_deg"] = math.degrees(scene.attitude.sigma_rad)
    if scene.elevation is not None:
        values.update(_grid(scene.elevation))
    return [TerrainQuality.model_validate(values)]


def _plane(scene: Scene, xyz: np.ndarray) -> dict[str, float]:
    """Measure the points about their dominant plane."""
    step = max(1, len(xyz) // PLANE_POINTS)
    tolerance = np.full(len(xyz[::step]), PLANE_TOLERANCE_M)
    if scene.points is not None and scene.points.covariance_m2 is not None:
        sigma = np.sqrt(scene.points.covariance_m2[::step, 5].astype(np.float64))
        tolerance = np.hypot(tolerance, 2.0 * sigma)
    fit = robust_plane(xyz[::step, :2], xyz[::step, 2], tolerance)
    if fit is None:
        return {}
    tilt = math.degrees(math.atan(math.hypot(float(fit.coefficients[0]), float(fit.coefficients[1]))))
    return {
        "plane_residual_m": fit.residual,
        "plane_inlier_fraction": float(fit.inliers.mean()),
        "plane_tilt_deg": tilt,
    }


def _grid(grid: ElevationMap) -> dict[str, float | int]:
    """Measure the elevation grid."""
    known = np.isfinite(np.asarray(grid.layers["elevation"], np.float64))
    filled = np.asarray(grid.layers["filled"], bool) if "filled" in grid.layers else np.zeros(known.shape, bool)
    measured = known & ~filled
    values: dict[str, float | int] = {
        "covered_cells": int(np.count_nonzero(measured)),
        "covered_m2": float(np.count_nonzero(measured)) * grid.cell_m**2,
        "extent_m": max(known.shape) * grid.cell_m,
    }
    if known.any():
        values["filled_fraction"] = float(np.count_nonzero(filled & known) / np.count_nonzero(known))
    density = _near_density(grid, measured)
    if density is not None:
        values["near_density"] = density
    for name, layer in (("median_sigma_m", "sigma_m"), ("median_slope_deg", "slope_deg")):
        if layer in grid.layers:
            found = np.asarray(grid.layers[layer], np.float64)[measured]
            found = found[np.isfinite(found)]
            if len(found):
                values[name] = float(np.median(found))
    return values


def _near_density(grid: ElevationMap, measured: Mask) -> float | None:
    """Return the measured fraction of the near cells in the seen sector, from its nearest measured cell outwards."""
    rows, columns = grid.shape
    x = grid.x0_m + (np.arange(columns) + 0.5) * grid.cell_m
    y = grid.y0_m + (np.arange(rows) + 0.5) * grid.cell_m
    distance = np.hypot(x[None, :], y[:, None])
    bearing = np.arctan2(y[:, None], x[None, :])
    seen = measured & (distance <= NEAR_M)
    if not seen.any():
        return None
    left, right = np.percentile(bearing[seen], [98.0, 2.0])
    nearest = float(np.percentile(distance[seen], 2.0))
    sector = (distance <= NEAR_M) & (distance >= nearest) & (bearing <= left) & (bearing >= right)
    cells = int(np.count_nonzero(sector))
    return float(np.count_nonzero(sector & measured) / cells) if cells else None


PROBE = Probe(
    name="measurement.terrain_quality",
    templates=(TerrainQuality,),
    function=measure_terrain_quality,
    tier="cheap",
    subject="terrain",
    summary="Completeness, flatness and plausibility of the reconstructed terrain.",
)
