"""Covariances of triangulated points: noise along the ray, pixel width across it, errors that all points share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modules.types import PointCloud, SharedError

ROWS, COLUMNS = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)  # order of the stored elements: xx, xy, xz, yy, yz, zz


def add_shared(covariance_m2: NDArray[np.float32], xyz_m: NDArray[np.float32], shared: SharedError) -> None:
    """Add the covariance of the shared errors to elements xx, xy, xz, yy, yz, zz (N, 6) of points (N, 3), in place.

    Small turns a, b about x and y move a point at (x, y, z) from the pivot by (b z, -a z, a y - b x). A relative error
    of focal length times baseline, and an offset of the disparity, move it along its ray.
    """
    if shared.tilt_rad > 0.0:
        x, y, z = (xyz_m[:, axis] - np.float32(shared.pivot_m[axis]) for axis in range(3))
        variance = np.float32(shared.tilt_rad**2)
        covariance_m2[:, 0] += variance * z * z
        covariance_m2[:, 2] -= variance * x * z
        covariance_m2[:, 3] += variance * z * z
        covariance_m2[:, 4] -= variance * y * z
        covariance_m2[:, 5] += variance * (x * x + y * y)
    if shared.scale > 0.0 or shared.offset_per_m > 0.0:
        ray = [xyz_m[:, axis] - np.float32(shared.camera_m[axis]) for axis in range(3)]
        relative = _relative_variance(ray, shared)
        for element, (i, j) in enumerate(zip(ROWS, COLUMNS, strict=True)):
            covariance_m2[:, element] += relative * ray[i] * ray[j]


def shared_height_variance(
    xyz_m: tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]], shared: SharedError
) -> NDArray[np.floating]:
    """Return the variance of z, m^2, that the shared errors cause at x, y, z of one shape."""
    x, y, z = xyz_m
    from_pivot = (x - shared.pivot_m[0]) ** 2 + (y - shared.pivot_m[1]) ** 2
    variance = shared.tilt_rad**2 * from_pivot + 0.0 * z
    if shared.scale > 0.0 or shared.offset_per_m > 0.0:
        ray = [value - shared.camera_m[axis] for axis, value in enumerate(xyz_m)]
        variance = variance + _relative_variance(ray, shared) * ray[2] ** 2
    return np.asarray(variance)


def own_height_variance(points: PointCloud, floor_m: float) -> NDArray[np.float32]:
    """Return the variance of z (N,), m^2, of the errors that the points do not share, at least `floor_m` squared."""
    if points.covariance_m2 is None:
        return np.full(len(points), 1e-4, np.float32)
    x, y, z = (points.xyz_m[:, axis] for axis in range(3))
    shared = shared_height_variance((x, y, z), points.shared)
    return np.maximum(points.covariance_m2[:, 5] - shared, np.float32(floor_m**2)).astype(np.float32)


def range_sigma(points: PointCloud) -> NDArray[np.float32]:
    """Return the standard deviation (N,), m, of the distance from the camera along the ray; 0 where none is stated."""
    if points.covariance_m2 is None:
        return np.zeros(len(points), np.float32)
    ray = points.xyz_m - np.asarray(points.shared.camera_m, np.float32)
    square = np.maximum(np.einsum("ij,ij->i", ray, ray), np.float32(1e-12))
    total = np.zeros(len(points), np.float32)
    for element, (i, j) in enumerate(zip(ROWS, COLUMNS, strict=True)):
        total += (1.0 if i == j else 2.0) * points.covariance_m2[:, element] * ray[:, i] * ray[:, j]
    return np.sqrt(np.maximum(total / square, 0.0)).astype(np.float32)


def _relative_variance(ray: list[NDArray[np.floating]], shared: SharedError) -> NDArray[np.floating]:
    """Return the relative variance of the distance along the ray that focal length, baseline and offset cause."""
    depth = ray[0] * shared.axis[0] + ray[1] * shared.axis[1] + ray[2] * shared.axis[2]
    return np.asarray(shared.scale**2 + (shared.offset_per_m * depth) ** 2)
