"""Points in the level frame from a disparity map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.frames import level_from_body
from modules.types import Attitude, Image, PointCloud, Scene, full_scale

PIXEL_SIGMA_PX = 0.29  # standard deviation of a position within one pixel, 1 / sqrt(12)


class TriangulateDisparityParams(OperatorParams):
    """Parameters of `triangulate_disparity`."""

    sigma_px: float = Field(
        0.25, gt=0.0, le=10.0, description="Standard deviation of the disparity where the matcher states none, px"
    )
    min_disparity_px: float = Field(
        0.25, gt=0.0, le=100.0, description="Smallest disparity + doffs that is triangulated, px"
    )


def triangulate_disparity(scene: Scene, params: TriangulateDisparityParams) -> Scene:
    """Triangulate every valid pixel into the level frame, with a covariance.

    `Z = f B / (d + doffs)`; optical to body by the mount, body to level by the attitude (level when None). The origin
    is the body origin, raised by the height of the ground plane where one was fitted, so that the ground is z = 0.

    Parameters
    ----------
    scene : Scene
        Needs `calibration`.
    params : TriangulateDisparityParams

    Returns
    -------
    Scene
        With `points`: float32 (N, 3) m; the covariance holds the disparity noise, which lies along the ray, and the
        width of the pixel, but not the attitude, whose error all points share. `rejected` counts `no_disparity` and
        `too_far`.

    Raises
    ------
    OperatorError
        Without calibration, or when it was made for another image size.

    References
    ----------
    L. Matthies and S. Shafer, "Error modeling in stereo navigation", IEEE Journal of Robotics and Automation 3 (1987).
    """
    calibration = scene.calibration
    if calibration is None:
        raise OperatorError("triangulation needs a calibration and the pair has none; give focal length and baseline")
    disparity = scene.disparity.disparity_px
    if disparity.shape != (calibration.height_px, calibration.width_px):
        raise OperatorError(
            f"the disparity is {disparity.shape[1]}x{disparity.shape[0]} and the calibration is for "
            f"{calibration.width_px}x{calibration.height_px}; use the calibration of this image size"
        )
    shifted = disparity.astype(np.float64).ravel() + calibration.doffs_px
    valid = np.isfinite(shifted)
    with np.errstate(invalid="ignore"):
        usable = valid & (shifted >= params.min_disparity_px)
    pixel = np.flatnonzero(usable)
    shifted = shifted[pixel]
    depth = calibration.focal_px * calibration.baseline_m / shifted
    rows, columns = np.divmod(pixel, disparity.shape[1])
    optical = np.column_stack(
        [
            (columns - calibration.cx_px) / calibration.focal_px * depth,
            (rows - calibration.cy_px) / calibration.focal_px * depth,
            depth,
        ]
    )
    attitude = scene.attitude if scene.attitude is not None else Attitude()
    level = level_from_body(attitude)
    rotation = level @ scene.mount.rotation
    lift = np.array([0.0, 0.0, scene.ground.height_m if scene.ground is not None else 0.0])
    ray = optical @ rotation.T
    xyz = ray + level @ np.asarray(scene.mount.translation_m) + lift
    sigma = np.full(len(pixel), params.sigma_px)
    if scene.disparity.sigma_px is not None:
        stated = scene.disparity.sigma_px.ravel()[pixel].astype(np.float64)
        sigma = np.where(np.isfinite(stated) & (stated > 0), stated, sigma)
    points = PointCloud(
        xyz_m=xyz.astype(np.float32),
        frame="level",
        pixel=pixel.astype(np.int32),
        rgb=_colours(scene.left, pixel),
        covariance_m2=_covariance(ray, sigma / shifted, PIXEL_SIGMA_PX * depth / calibration.focal_px, rotation[:, 2]),
    )
    rejected = {
        **scene.rejected,
        "no_disparity": int(valid.size - np.count_nonzero(valid)),
        "too_far": int(np.count_nonzero(valid) - len(pixel)),
    }
    return replace(scene, points=points, elevation=None, rejected={name: n for name, n in rejected.items() if n})


def _covariance(
    ray: NDArray[np.float64], relative: NDArray[np.float64], width: NDArray[np.float64], axis: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return xx, xy, xz, yy, yz, zz (N, 6): `relative` error along the ray and `width` across the optical axis."""
    rows, columns = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])
    across = (np.eye(3) - np.outer(axis, axis))[rows, columns]
    along = ray[:, rows] * ray[:, columns] * (relative**2)[:, None]
    return np.asarray(along + (width**2)[:, None] * across, np.float32)


def _colours(image: Image, pixel: NDArray[np.intp]) -> NDArray[np.uint8]:
    """Return the colour (N, 3) of each pixel on the 8-bit scale."""
    flat = image.reshape(-1, 1 if image.ndim == 2 else image.shape[2])[pixel]
    eight = np.rint(flat.astype(np.float32) * (255.0 / full_scale(image))).astype(np.uint8)
    return np.repeat(eight, 3, axis=1) if eight.shape[1] == 1 else eight


OPERATOR = Operator(
    name="reconstruction.triangulate_disparity",
    slot="triangulate",
    params=TriangulateDisparityParams,
    function=triangulate_disparity,
    cost=Cost(fixed_ms=0.5, ns_per_pixel=250.0),
    summary="Triangulates every valid pixel into the level frame, with its covariance.",
    suits="Always; the result is as good as the calibration and the attitude.",
    needs=("calibration",),
)
