"""Facts about a reconstructed terrain."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import cv2
import numpy as np

from modules.primitives.frames import level_from_body
from modules.primitives.patches import highest, lowest
from modules.primitives.photometry import to_8_bit, to_gray
from modules.primitives.planes import robust_plane
from modules.primitives.sky import find_sky
from modules.primitives.statistics import robust_sigma
from modules.probe import FactModel, Probe, quantity
from modules.types import Attitude, ElevationMap, Mask, Scene, Sight

NEAR_M = 6.0  # where a rover plans its next metres
PLANE_TOLERANCE_M = 0.15
PLANE_POINTS = 8_000
RINGS: dict[Literal["near", "middle", "far"], tuple[float, float]] = {
    "near": (0.0, 3.0),
    "middle": (3.0, 6.0),
    "far": (6.0, math.inf),
}
WALL_M = 0.5
SPIKE_M, SPIKE_SIGMAS = 0.1, 5.0
LEAST_CELLS = 100
LEAST_CAMERA_M = 0.2  # below this the mount says nothing of the height above the wheels
ASSUMED_SIGMA_RAD = math.radians(5.0)  # an attitude less certain than this was assumed, not measured
FAR_PERCENT = 10.0
FAR_PIXELS = 100
BEYOND_PX = 2.0  # sky and far hills scatter about infinity by less


class TerrainQuality(FactModel):
    """How complete, how flat and how plausible the terrain is."""

    template: ClassVar[str] = "terrain_quality"

    point_count: int = quantity("Points after gating", ge=0)
    kept_fraction: float = quantity("Points kept of the pixels that have a disparity", ge=0.0, le=1.0, resolution=0.001)
    behind_camera_fraction: float = quantity(
        f"Matched pixels with disparity + doffs below {-BEYOND_PX:g} px, which would lie behind the camera",
        ge=0.0,
        le=1.0,
        resolution=0.001,
    )
    far_disparity_px: float | None = quantity(
        f"Disparity + doffs of the far end of these pixels: {FAR_PERCENT:g} % quantile, without what looks like sky",
        unit="px",
        resolution=0.01,
        default=None,
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
    levelled_by: Literal["attitude", "ground_plane", "nothing"] = quantity(
        "What gave the level frame", default="nothing"
    )
    negated_tilt_deg: float | None = quantity(
        "Tilt of the dominant plane, were roll and pitch of the other sign",
        unit="deg",
        ge=0.0,
        le=90.0,
        resolution=0.01,
        default=None,
    )
    radians_tilt_deg: float | None = quantity(
        "Tilt of the dominant plane, were the numbers of roll and pitch radians and not degrees; if they can be",
        unit="deg",
        ge=0.0,
        le=90.0,
        resolution=0.01,
        default=None,
    )
    ground_height_ratio: float | None = quantity(
        "Height of the dominant plane under the camera over that of the camera; 0 where the wheels stand on it",
        resolution=0.001,
        default=None,
    )
    above_camera_fraction: float | None = quantity(
        "Points higher above the dominant plane than the camera, by two sigma: matched sky, cliffs or tall rocks",
        ge=0.0,
        le=1.0,
        resolution=0.0001,
        default=None,
    )
    wall_fraction: float | None = quantity(
        f"Measured cells whose points span more than {WALL_M:g} m of height: walls, overhangs or wrong matches",
        ge=0.0,
        le=1.0,
        resolution=0.0001,
        default=None,
    )
    spike_fraction: float | None = quantity(
        f"Measured cells above or below all neighbours by more than {SPIKE_M:g} m and {SPIKE_SIGMAS:g} sigma",
        ge=0.0,
        le=1.0,
        resolution=0.0001,
        default=None,
    )
    scatter_ratio: float | None = quantity(
        "Robust difference of cells from their neighbours over that by the predicted sigma; above 1 on rough terrain",
        ge=0.0,
        resolution=0.01,
        default=None,
    )
    far_scatter_ratio: float | None = quantity(
        "The same for the farther half of the cells, where noise hides the roughness",
        ge=0.0,
        resolution=0.01,
        default=None,
    )


class TerrainRing(FactModel):
    """How well a ring about the camera is known."""

    template: ClassVar[str] = "terrain_ring"
    keys: ClassVar[tuple[str, ...]] = ("ring",)

    ring: Literal["near", "middle", "far"] = quantity("Up to 3 m, 3 to 6 m, and beyond, from the camera")
    seen_m2: float = quantity("Area of the map in view of the camera", unit="m2", ge=0.0, resolution=0.01)
    covered_fraction: float = quantity("Measured part of it", ge=0.0, le=1.0, resolution=0.001)
    occluded_fraction: float = quantity("Part hidden by nearer terrain", ge=0.0, le=1.0, resolution=0.001)
    points_per_m2: float = quantity("Points over the measured area", unit="1/m2", ge=0.0, resolution=0.1)
    median_sigma_m: float | None = quantity(
        "Median elevation uncertainty", unit="m", ge=0.0, resolution=0.0001, default=None
    )


class Rejection(FactModel):
    """Pixels that gave no point, by reason."""

    template: ClassVar[str] = "rejection"
    keys: ClassVar[tuple[str, ...]] = ("reason",)

    reason: str = quantity("Why they were dropped")
    count: int = quantity("How many", ge=0)
    fraction: float = quantity("Of the pixels that have a disparity", ge=0.0, resolution=0.0001)


def measure_terrain_quality(scene: Scene) -> list[FactModel]:
    """Measure the points and the elevation grid of a scene.

    Parameters
    ----------
    scene : Scene
        After reconstruction; points, grid and layers may be missing, and the fields that need them are then None.

    Returns
    -------
    list of FactModel
        One `TerrainQuality`, a `TerrainRing` per ring in view and a `Rejection` per reason; none when nothing was
        triangulated.
    """
    points = scene.points
    if points is None:
        return []
    values: dict[str, float | int | str] = {
        "point_count": len(points),
        "behind_camera_fraction": 0.0,
        "kept_fraction": 0.0,
    }
    matched = int(np.count_nonzero(scene.disparity.valid))
    if matched:
        values["kept_fraction"] = min(1.0, len(points) / matched)
        values.update(_behind(scene))
    if len(points):
        xyz = points.xyz_m.astype(np.float64)
        values["median_range_m"] = float(np.median(np.hypot(xyz[:, 0], xyz[:, 1])))
        values.update(_plane(scene, xyz))
    if scene.attitude is not None:
        values["attitude_sigma_deg"] = math.degrees(scene.attitude.sigma_rad)
    if scene.elevation is not None:
        values.update(_grid(scene.elevation))
    if scene.ground is not None:
        values["levelled_by"] = "ground_plane"
    elif scene.attitude is not None and scene.attitude.sigma_rad < ASSUMED_SIGMA_RAD:
        values["levelled_by"] = "attitude"
    rejected = [
        Rejection(reason=reason, count=count, fraction=count / matched)
        for reason, count in sorted(scene.rejected.items())
        if matched and reason != "no_disparity"
    ]
    rings = _rings(scene, scene.elevation) if scene.elevation is not None else []
    return [TerrainQuality.model_validate(values), *rings, *rejected]


def _behind(scene: Scene) -> dict[str, float]:
    """Measure the matched pixels that lie clearly beyond infinity."""
    doffs = 0.0 if scene.calibration is None else scene.calibration.doffs_px
    with np.errstate(invalid="ignore"):
        behind = scene.disparity.valid & (scene.disparity.disparity_px + doffs < -BEYOND_PX)
    found = {"behind_camera_fraction": float(np.count_nonzero(behind) / np.count_nonzero(scene.disparity.valid))}
    if np.count_nonzero(behind) < FAR_PIXELS:
        return found
    ground = behind & ~find_sky(to_8_bit(to_gray(scene.left)))
    chosen = ground if np.count_nonzero(ground) >= FAR_PIXELS else behind
    far = scene.disparity.disparity_px[chosen].astype(np.float64) + doffs
    return {**found, "far_disparity_px": float(np.percentile(far, FAR_PERCENT))}


def _plane(scene: Scene, xyz: np.ndarray) -> dict[str, float]:
    """Measure the points about their dominant plane."""
    step = max(1, len(xyz) // PLANE_POINTS)
    sigma = np.zeros(len(xyz[::step]))
    if scene.points is not None and scene.points.covariance_m2 is not None:
        sigma = np.sqrt(scene.points.covariance_m2[::step, 5].astype(np.float64))
    tolerance = np.hypot(PLANE_TOLERANCE_M, 2.0 * sigma)
    fit = robust_plane(xyz[::step, :2], xyz[::step, 2], tolerance)
    if fit is None:
        return {}
    a, b, c = (float(value) for value in fit.coefficients)
    tilt = math.degrees(math.atan(math.hypot(a, b)))
    found = {} if scene.ground is not None else _against_attitude(scene, (a, b, c))
    if scene.points is not None:
        x, y, z = scene.points.shared.camera_m
        camera = z - (a * x + b * y + c)
        if camera > LEAST_CAMERA_M:
            height = xyz[::step, 2] - fit.at(xyz[::step, 0], xyz[::step, 1])
            found["above_camera_fraction"] = float(np.mean(height - 2.0 * sigma > camera))
    return {
        **found,
        "plane_residual_m": fit.residual,
        "plane_inlier_fraction": float(fit.inliers.mean()),
        "plane_tilt_deg": tilt,
    }


def _against_attitude(scene: Scene, plane: tuple[float, float, float]) -> dict[str, float]:
    """Compare the dominant plane z = a x + b y + c with the attitude and the mount."""
    attitude = scene.attitude if scene.attitude is not None else Attitude()
    a, b, c = plane
    normal = np.array([-a, -b, 1.0]) / math.sqrt(a * a + b * b + 1.0)
    up_body = level_from_body(attitude).T @ normal

    def tilt_deg(roll_rad: float, pitch_rad: float) -> float:
        up = level_from_body(Attitude(roll_rad, pitch_rad, attitude.yaw_rad)) @ up_body
        return math.degrees(math.acos(min(1.0, abs(float(up[2])))))

    found = {"negated_tilt_deg": tilt_deg(-attitude.roll_rad, -attitude.pitch_rad)}
    as_radians = math.degrees(attitude.roll_rad), math.degrees(attitude.pitch_rad)
    if max(map(abs, as_radians)) < math.pi / 2:
        found["radians_tilt_deg"] = tilt_deg(*as_radians)
    camera = level_from_body(attitude) @ np.asarray(scene.mount.translation_m)
    if camera[2] > LEAST_CAMERA_M:
        found["ground_height_ratio"] = float((a * camera[0] + b * camera[1] + c) / camera[2])
    return found


def _rings(scene: Scene, grid: ElevationMap) -> list[TerrainRing]:
    """Measure the rings about the camera; none without the layer `sight`."""
    if "sight" not in grid.layers or scene.points is None:
        return []
    rows, columns = grid.shape
    camera = scene.points.shared.camera_m
    x = grid.x0_m + (np.arange(columns) + 0.5) * grid.cell_m - camera[0]
    y = grid.y0_m + (np.arange(rows) + 0.5) * grid.cell_m - camera[1]
    distance = np.hypot(x[None, :], y[:, None])
    sight, count = np.asarray(grid.layers["sight"]), np.asarray(grid.layers["count"])
    sigma = np.asarray(grid.layers["sigma_m"], np.float64)
    cell_m2 = grid.cell_m**2
    rings = []
    for name, (inner, outer) in RINGS.items():
        seen = (distance >= inner) & (distance < outer) & (sight != Sight.OUT_OF_VIEW)
        area = int(np.count_nonzero(seen))
        measured = seen & (sight == Sight.MEASURED)
        known = int(np.count_nonzero(measured))
        if area == 0:
            continue
        rings.append(
            TerrainRing(
                ring=name,
                seen_m2=area * cell_m2,
                covered_fraction=known / area,
                occluded_fraction=float(np.count_nonzero(seen & (sight == Sight.OCCLUDED))) / area,
                points_per_m2=float(count[measured].sum()) / (known * cell_m2) if known else 0.0,
                median_sigma_m=float(np.median(sigma[measured])) if known else None,
            )
        )
    return rings


def _defects(grid: ElevationMap, measured: Mask) -> dict[str, float]:
    """Measure walls, spikes and the scatter between neighbouring cells."""
    z, sigma = (np.asarray(grid.layers[name], np.float64) for name in ("elevation", "sigma_m"))
    total = max(int(np.count_nonzero(measured)), 1)
    span = np.asarray(grid.layers["max_m"], np.float64) - np.asarray(grid.layers["min_m"], np.float64)
    found = {"wall_fraction": float(np.count_nonzero(measured & (span > WALL_M))) / total}
    around = np.ones((3, 3), np.uint8)
    around[1, 1] = 0
    limit = np.maximum(SPIKE_M, SPIKE_SIGMAS * np.nan_to_num(sigma))
    with np.errstate(invalid="ignore"):
        spike = (z - highest(z, around) > limit) | (lowest(z, around) - z > limit)
    # A cell without neighbours is an island, not a spike.
    company = cv2.filter2D(np.isfinite(z).astype(np.uint8), -1, around, borderType=cv2.BORDER_CONSTANT)
    found["spike_fraction"] = float(np.count_nonzero(measured & spike & (company >= 3))) / total
    difference = z[:, 1:-1] - 0.5 * (z[:, :-2] + z[:, 2:])
    expected = np.sqrt(sigma[:, 1:-1] ** 2 + 0.25 * (sigma[:, :-2] ** 2 + sigma[:, 2:] ** 2))
    use = measured[:, 1:-1] & measured[:, :-2] & measured[:, 2:] & (expected > 0)
    if np.count_nonzero(use) >= LEAST_CELLS:
        ratio = difference[use] / expected[use]
        found["scatter_ratio"] = robust_sigma(ratio)
        far = expected[use] >= np.median(expected[use])
        found["far_scatter_ratio"] = robust_sigma(ratio[far])
    return found


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
    if {"sigma_m", "max_m", "min_m"} <= set(grid.layers):
        values.update(_defects(grid, measured))
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
    templates=(TerrainQuality, TerrainRing, Rejection),
    function=measure_terrain_quality,
    tier="cheap",
    subject="terrain",
    summary="Completeness, flatness and plausibility of the reconstructed terrain.",
)
