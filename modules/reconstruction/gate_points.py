"""Points too far, too uncertain, too flat to the ground, too high or too low, or part of the robot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.covariance import range_sigma
from modules.primitives.frames import level_from_body
from modules.primitives.planes import PlaneFit, robust_plane
from modules.types import Attitude, Mask, PointCloud, Scene

PLANE_POINTS = 8_000
PLANE_TOLERANCE_M = 0.15


class GatePointsParams(OperatorParams):
    """Parameters of `gate_points`."""

    min_range_m: float = Field(0.2, ge=0.0, le=100.0, description="Nearest horizontal distance from the camera, m")
    max_range_m: float = Field(20.0, gt=0.0, le=10000.0, description="Farthest horizontal distance from the camera, m")
    max_sigma_m: float = Field(
        0.6, gt=0.0, le=1000.0, description="Largest standard deviation of the distance along the ray, m"
    )
    min_confidence: float = Field(
        0.0, ge=0.0, le=1.0, description="Smallest confidence of the matcher, where it states one"
    )
    min_grazing_deg: float = Field(
        0.0, ge=0.0, le=90.0, description="Smallest angle between the ray and the dominant plane, deg"
    )
    max_above_m: float = Field(2.0, ge=0.0, le=1000.0, description="Largest height above the dominant plane, m")
    max_below_m: float = Field(1.0, ge=0.0, le=1000.0, description="Largest depth below the dominant plane, m")
    body_front_m: float = Field(0.0, ge=0.0, le=100.0, description="The robot reaches this far ahead of the origin, m")
    body_back_m: float = Field(0.0, ge=0.0, le=100.0, description="The robot reaches this far behind the origin, m")
    body_side_m: float = Field(0.0, ge=0.0, le=100.0, description="Half of the width of the robot, m; 0 for no box")


def gate_points(scene: Scene, params: GatePointsParams) -> Scene:
    """Drop points outside the bounds and count them by the first reason that applies.

    Heights are measured from the plane fitted robustly to the points that pass the gates before, so a slope stays.

    Parameters
    ----------
    scene : Scene
        Needs `points`.
    params : GatePointsParams

    Returns
    -------
    Scene
        With fewer points and the counts `too_near`, `out_of_range`, `uncertain`, `unconfident`, `robot_body`,
        `grazing`, `too_high` and `too_low` in `rejected`.

    Raises
    ------
    OperatorError
        When there are no points, or none is left.
    """
    points = scene.points
    if points is None or len(points) == 0:
        raise OperatorError("there are no points to gate; triangulate a disparity map with valid pixels first")
    rejected = dict(scene.rejected)
    keep = np.ones(len(points), bool)

    def drop(where: Mask, reason: str) -> None:
        hit = keep & where
        count = int(np.count_nonzero(hit))
        if count:
            rejected[reason] = rejected.get(reason, 0) + count
            keep[hit] = False

    camera = points.shared.camera_m
    distance = np.hypot(points.xyz_m[:, 0] - np.float32(camera[0]), points.xyz_m[:, 1] - np.float32(camera[1]))
    drop(distance < params.min_range_m, "too_near")
    drop(distance > params.max_range_m, "out_of_range")
    drop(range_sigma(points) > params.max_sigma_m, "uncertain")
    if params.min_confidence > 0.0 and scene.disparity.confidence is not None:
        drop(scene.disparity.confidence.ravel()[points.pixel] < params.min_confidence, "unconfident")
    if params.body_side_m > 0.0:
        drop(_in_body(scene, points, params), "robot_body")
    fit = _dominant_plane(points, keep)
    if fit is not None:
        if params.min_grazing_deg > 0.0:
            drop(_grazing_sine(points, fit) < math.sin(math.radians(params.min_grazing_deg)), "grazing")
        xyz = points.xyz_m.astype(np.float64)
        height = xyz[:, 2] - fit.at(xyz[:, 0], xyz[:, 1])
        drop(height > params.max_above_m, "too_high")
        drop(height < -params.max_below_m, "too_low")
    if not keep.any():
        counts = ", ".join(f"{name} {n}" for name, n in rejected.items())
        raise OperatorError(f"the gates dropped all {len(points)} points ({counts}); widen the bound that dropped most")
    return replace(scene, points=points.select(keep), rejected=rejected)


def _in_body(scene: Scene, points: PointCloud, params: GatePointsParams) -> Mask:
    """Return which points (N,) lie in the upright box of the robot, whose sides are those of the body frame."""
    attitude = scene.attitude if scene.attitude is not None else Attitude()
    to_body = level_from_body(attitude).astype(np.float32)  # its columns are the body axes
    relative = points.xyz_m - np.asarray(points.shared.pivot_m, np.float32)
    ahead, left = np.einsum("nj,jk->kn", relative, to_body[:, :2])
    return np.asarray(
        (ahead <= params.body_front_m) & (ahead >= -params.body_back_m) & (np.abs(left) <= params.body_side_m)
    )


def _dominant_plane(points: PointCloud, keep: Mask) -> PlaneFit | None:
    """Return the plane of most of the kept points; level through their median where there is none."""
    chosen = np.flatnonzero(keep)
    if len(chosen) == 0:
        return None
    chosen = chosen[:: max(1, len(chosen) // PLANE_POINTS)]
    xyz = points.xyz_m[chosen].astype(np.float64)
    tolerance = np.full(len(chosen), PLANE_TOLERANCE_M)
    if points.covariance_m2 is not None:
        tolerance = np.hypot(tolerance, 2.0 * np.sqrt(points.covariance_m2[chosen, 5].astype(np.float64)))
    fit = robust_plane(xyz[:, :2], xyz[:, 2], tolerance)
    if fit is None:
        return PlaneFit(np.array([0.0, 0.0, float(np.median(xyz[:, 2]))]), np.ones(len(chosen), bool), 0.0)
    return fit


def _grazing_sine(points: PointCloud, fit: PlaneFit) -> NDArray[np.floating]:
    """Return the sine (N,) of the angle between each ray and the plane."""
    a, b, _ = fit.coefficients
    normal = np.array([-a, -b, 1.0]) / math.sqrt(a * a + b * b + 1.0)
    ray = points.xyz_m - np.asarray(points.shared.camera_m, np.float32)
    length = np.maximum(np.sqrt(np.einsum("ij,ij->i", ray, ray)), 1e-9)
    return np.asarray(np.abs(np.einsum("nj,j->n", ray, normal.astype(np.float32))) / length)


OPERATOR = Operator(
    name="reconstruction.gate_points",
    slot="gate",
    params=GatePointsParams,
    function=gate_points,
    cost=Cost(fixed_ms=10.0, ns_per_pixel=50.0),
    summary="Drops points that are too far, too uncertain, too high or too low, or the robot's, and counts them.",
    suits="Always; narrow heights cut off cliffs and overhangs.",
)
