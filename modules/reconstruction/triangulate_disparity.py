"""Points in the level frame from a disparity map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.covariance import COLUMNS, ROWS, add_shared
from modules.primitives.frames import level_from_body
from modules.types import Attitude, Calibration, Image, Mask, PointCloud, Scene, SharedError, full_scale

PIXEL_SIGMA_PX = 0.29  # standard deviation of a position within one pixel, 1 / sqrt(12)

BEHIND_PX = -1.0  # disparities of the sky scatter about 0; a point behind the camera is clearly below

Floats = NDArray[np.float32]


class TriangulateDisparityParams(OperatorParams):
    """Parameters of `triangulate_disparity`."""

    sigma_px: float = Field(
        0.25, gt=0.0, le=10.0, description="Standard deviation of the disparity where the matcher states none, px"
    )
    scale_sigma: float = Field(
        0.0, ge=0.0, le=0.5, description="Relative standard deviation of focal length times baseline, all points alike"
    )
    offset_sigma_px: float = Field(
        0.0, ge=0.0, le=10.0, description="Standard deviation of the disparity offset that all points share, px"
    )
    offset_px: float = Field(0.0, ge=-200.0, le=200.0, description="Added to disparity + doffs, px")
    min_disparity_px: float = Field(
        0.25, gt=0.0, le=100.0, description="Smallest disparity + doffs that is triangulated, px"
    )


def triangulate_disparity(scene: Scene, params: TriangulateDisparityParams) -> Scene:
    """Triangulate every valid pixel into the level frame, with a covariance.

    `Z = f B / (d + doffs + offset)`; optical to body by the mount, body to level by the attitude (level when None).
    The origin is the body origin, raised by the height of the ground plane where one was fitted, so that the ground is
    z = 0.

    Parameters
    ----------
    scene : Scene
        Needs `calibration`.
    params : TriangulateDisparityParams

    Returns
    -------
    Scene
        With `points`: float32 (N, 3) m. The covariance is the sum of the disparity's noise, which lies along the ray,
        the width of the pixel, and what all points share: attitude, focal length and baseline, disparity offset; the
        shared part is stated in `points.shared` as well, since no averaging removes it. `rejected` counts
        `no_disparity`, `masked`, `behind_camera` (d + doffs below -1 px) and `too_far`.

    Raises
    ------
    OperatorError
        Without calibration, when it was made for another image size, or when no pixel can be triangulated.

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
    shifted = (disparity + np.float32(calibration.doffs_px + params.offset_px)).ravel()
    usable, rejected = _usable(shifted, scene.mask, params.min_disparity_px)
    pixel = np.flatnonzero(usable)
    if len(pixel) == 0:
        raise OperatorError(_nothing(rejected, calibration))
    shifted = shifted[pixel]
    attitude = scene.attitude if scene.attitude is not None else Attitude()
    level = level_from_body(attitude)
    rotation = level @ scene.mount.rotation
    pivot = (0.0, 0.0, scene.ground.height_m if scene.ground is not None else 0.0)
    camera = level @ np.asarray(scene.mount.translation_m) + np.asarray(pivot)
    depth = np.float32(calibration.focal_px * calibration.baseline_m) / shifted
    ray = _rays(calibration, rotation.astype(np.float32), pixel, depth)
    shared = SharedError(
        pivot_m=pivot,
        camera_m=(float(camera[0]), float(camera[1]), float(camera[2])),
        axis=(float(rotation[0, 2]), float(rotation[1, 2]), float(rotation[2, 2])),
        tilt_rad=attitude.sigma_rad,
        scale=params.scale_sigma,
        offset_per_m=params.offset_sigma_px / (calibration.focal_px * calibration.baseline_m),
    )
    sigma = _sigma(scene.disparity.sigma_px, pixel, params.sigma_px)
    width = np.float32(PIXEL_SIGMA_PX / calibration.focal_px) * depth
    covariance = _own_covariance(ray, sigma / shifted, width, rotation[:, 2].astype(np.float32))
    xyz = np.empty((len(pixel), 3), np.float32)
    for axis in range(3):
        xyz[:, axis] = ray[axis] + np.float32(camera[axis])
    add_shared(covariance, xyz, shared)
    points = PointCloud(xyz, "level", pixel.astype(np.int32), _colours(scene.left, pixel), covariance, shared)
    counts = {**scene.rejected, **rejected}
    return replace(scene, points=points, elevation=None, rejected={name: n for name, n in counts.items() if n})


def _usable(shifted: Floats, mask: Mask | None, smallest_px: float) -> tuple[Mask, dict[str, int]]:
    """Return which pixels (N,) can be triangulated, and the counts of the others by reason."""
    valid = np.isfinite(shifted)
    seen = valid if mask is None else valid & mask.ravel()
    with np.errstate(invalid="ignore"):
        usable = seen & (shifted >= smallest_px)
        behind = seen & (shifted <= BEHIND_PX)
    total, matched, allowed = valid.size, np.count_nonzero(valid), np.count_nonzero(seen)
    negative = np.count_nonzero(behind)
    return usable, {
        "no_disparity": int(total - matched),
        "masked": int(matched - allowed),
        "behind_camera": int(negative),
        "too_far": int(allowed - negative - np.count_nonzero(usable)),
    }


def _nothing(rejected: dict[str, int], calibration: Calibration) -> str:
    """Say why no pixel is left, by the reason that took most."""
    reason = max(rejected, key=lambda name: rejected[name])
    remedy = {
        "no_disparity": "the matcher found nothing; check the pair and the disparity range",
        "masked": "the mask hides every matched pixel; check the mask",
        "behind_camera": f"d + doffs is negative; check doffs ({calibration.doffs_px:g} px) of the calibration",
        "too_far": "everything is beyond the reach of this baseline; check doffs and the disparity range",
    }[reason]
    counts = ", ".join(f"{name} {count}" for name, count in rejected.items() if count)
    return f"no pixel can be triangulated ({counts}): {remedy}"


def _rays(calibration: Calibration, rotation: Floats, pixel: NDArray[np.intp], depth: Floats) -> list[Floats]:
    """Return the vectors from the camera to the points, level axes: three arrays (N,), m."""
    rows, columns = np.divmod(pixel.astype(np.int32), np.int32(calibration.width_px))
    x = (columns - np.float32(calibration.cx_px)) * (depth / np.float32(calibration.focal_px))
    y = (rows - np.float32(calibration.cy_px)) * (depth / np.float32(calibration.focal_px))
    return [rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * depth for i in range(3)]


def _sigma(stated: Floats | None, pixel: NDArray[np.intp], default_px: float) -> Floats:
    """Return the standard deviation of the disparity of each pixel (N,), px."""
    if stated is None:
        return np.full(len(pixel), default_px, np.float32)
    sigma = stated.ravel()[pixel]
    return np.where(np.isfinite(sigma) & (sigma > 0), sigma, np.float32(default_px)).astype(np.float32)


def _own_covariance(ray: list[Floats], relative: Floats, width: Floats, axis: Floats) -> Floats:
    """Return xx, xy, xz, yy, yz, zz (N, 6): `relative` error along the ray and `width` across the optical axis."""
    along, across = relative * relative, width * width
    covariance = np.empty((len(relative), 6), np.float32)
    for element, (i, j) in enumerate(zip(ROWS, COLUMNS, strict=True)):
        projector = np.float32(i == j) - axis[i] * axis[j]
        covariance[:, element] = along * ray[i] * ray[j] + projector * across
    return covariance


def _colours(image: Image, pixel: NDArray[np.intp]) -> NDArray[np.uint8]:
    """Return the colour (N, 3) of each pixel on the 8-bit scale."""
    eight = image
    if image.dtype != np.uint8:
        eight = np.rint(image.astype(np.float32) * (255.0 / full_scale(image))).astype(np.uint8)
    if eight.ndim == 2:
        return np.repeat(eight.reshape(-1, 1)[pixel], 3, axis=1).astype(np.uint8)
    return np.asarray(eight.reshape(-1, 3)[pixel], np.uint8)


OPERATOR = Operator(
    name="reconstruction.triangulate_disparity",
    slot="triangulate",
    params=TriangulateDisparityParams,
    function=triangulate_disparity,
    cost=Cost(fixed_ms=0.5, ns_per_pixel=120.0),
    summary="Triangulates every valid pixel into the level frame, with its covariance.",
    suits="Always; the result is as good as the calibration and the attitude.",
    needs=("calibration",),
)
