"""Points too far, too uncertain, too high or too low."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.frames import level_from_body
from modules.primitives.planes import robust_plane
from modules.types import Attitude, Mask, PointCloud, Scene

PLANE_POINTS = 20_000
PLANE_TOLERANCE_M = 0.15


class GatePointsParams(OperatorParams):
    """Parameters of `gate_points`."""

    min_range_m: float = Field(0.2, ge=0.0, le=100.0, description="Nearest horizontal distance from the camera, m")
    max_range_m: float = Field(20.0, gt=0.0, le=10000.0, description="Farthest horizontal distance from the camera, m")
    max_sigma_m: float = Field(
        0.6, gt=0.0, le=1000.0, description="Largest standard deviation of the distance along the ray, m"
    )
    max_above_m: float = Field(2.0, ge=0.0, le=1000.0, description="Largest height above the dominant plane, m")
    max_below_m: float = Field(1.0, ge=0.0, le=1000.0, description="Largest depth below the dominant plane, m")


def gate_points(scene: Scene, params: GatePointsParams) -> Scene:
    """Drop points outside the bounds and count them by the first reason that applies.

    Heights are measured from the plane fitted robustly to the points that pass the other gates, so a slope stays.

    Parameters
    ----------
    scene : Scene
        Needs `points`.
    params : GatePointsParams

    Returns
    -------
    Scene
        With fewer points and the counts `too_near`, `out_of_range`, `uncertain`, `too_high` and `too_low` in
        `rejected`.

    Raises
    ------
    OperatorError
        When there are no points, or none is left.
    """
    points = scene.points
    if points is None or len(points) == 0:
        raise OperatorError("there are no points to gate; triangulate a disparity map with valid pixels first")
    distance, sigma = _distance_and_sigma(scene, points)
    rejected = dict(scene.rejected)
    keep = np.ones(len(points), bool)

    def drop(where: Mask, reason: str) -> None:
        hit = keep & where
        if hit.any():
            rejected[reason] = rejected.get(reason, 0) + int(np.count_nonzero(hit))
            keep[hit] = False

    drop(distance < params.min_range_m, "too_near")
    drop(distance > params.max_range_m, "out_of_range")
    drop(sigma > params.max_sigma_m, "uncertain")
    if keep.any():
        height = _height_above_plane(points, keep)
        drop(height > params.max_above_m, "too_high")
        drop(height < -params.max_below_m, "too_low")
    if not keep.any():
        counts = ", ".join(f"{name} {n}" for name, n in rejected.items())
        raise OperatorError(f"the gates dropped all {len(points)} points ({counts}); widen the bound that dropped most")
    return replace(scene, points=points.select(keep), rejected=rejected)


def _distance_and_sigma(scene: Scene, points: PointCloud) -> tuple[np.ndarray, np.ndarray]:
    """Return the horizontal distance from the camera (N,) and the sigma along the ray (N,), m."""
    attitude = scene.attitude if scene.attitude is not None else Attitude()
    camera = level_from_body(attitude) @ np.asarray(scene.mount.translation_m)
    distance = np.hypot(points.xyz_m[:, 0] - camera[0], points.xyz_m[:, 1] - camera[1])
    if points.covariance_m2 is None:
        return distance, np.zeros(len(points))
    # The ellipsoid is a needle along the ray: the root of its trace is its length but for the width of a pixel.
    trace = points.covariance_m2[:, 0] + points.covariance_m2[:, 3] + points.covariance_m2[:, 5]
    return distance, np.sqrt(trace)


def _height_above_plane(points: PointCloud, keep: Mask) -> np.ndarray:
    """Return the height (N,) above the dominant plane of the kept points, m."""
    chosen = np.flatnonzero(keep)
    chosen = chosen[:: max(1, len(chosen) // PLANE_POINTS)]
    xyz = points.xyz_m.astype(np.float64)
    tolerance = np.full(len(chosen), PLANE_TOLERANCE_M)
    if points.covariance_m2 is not None:
        tolerance = np.hypot(tolerance, 2.0 * np.sqrt(points.covariance_m2[chosen, 5].astype(np.float64)))
    fit = robust_plane(xyz[chosen, :2], xyz[chosen, 2], tolerance)
    if fit is None:
        return xyz[:, 2] - float(np.median(xyz[chosen, 2]))
    return xyz[:, 2] - fit.at(xyz[:, 0], xyz[:, 1])


OPERATOR = Operator(
    name="reconstruction.gate_points",
    slot="gate",
    params=GatePointsParams,
    function=gate_points,
    cost=Cost(fixed_ms=20.0, ns_per_pixel=60.0),
    summary="Drops points that are too far, too uncertain, too high or too low, and counts them by reason.",
    suits="Always; narrow heights cut off cliffs and overhangs.",
)
