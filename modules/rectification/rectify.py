"""Rectify the images of a calibrated rig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.warp import warp
from modules.types import Calibration, Camera, Image, Mask, Rectification, StereoRig

Array = NDArray[np.float64]

BORDER_SAMPLES = 65  # points per side of the image that outline its field of view
MAX_RAY_TANGENT = 3.0  # rays beyond 71.6 degrees do not decide on the size of the rectified plane
SAME_PX = 0.05  # a rig whose images move by less when rectified is rectified already
RADIUS_STEPS = 2000
LOST = 1e5
POLISH = 20  # steps
CONVERGED = 1e-8  # of the focal length
MAX_STEP = 0.1  # a larger one is no rounding but a point beyond the model


class RectificationError(ValueError):
    """A rig cannot be rectified; the message names the value, the limit and the remedy."""


@dataclass(frozen=True)
class RectifiedImages:
    """A rectified pair.

    Attributes
    ----------
    left, right : (H, W) or (H, W, 3), dtype of the raw images
    left_mask, right_mask : bool (H, W)
        True where the camera saw something.
    rectification : Rectification
    """

    left: Image
    right: Image
    left_mask: Mask
    right_mask: Mask
    rectification: Rectification


def rectify_images(left: Image, right: Image, rig: StereoRig, alpha: float | None = None) -> RectifiedImages:
    """Undo the distortion and turn both images onto one plane parallel to the baseline.

    Parameters
    ----------
    left, right : (H, W) or (H, W, 3), uint8 or uint16
        As the cameras of `rig` took them.
    rig : StereoRig
    alpha : float, optional
        0 zooms until no pixel lies beyond what the cameras saw, 1 keeps everything they saw. By default the
        rectification that the calibration prescribes, or else 0.

    Returns
    -------
    RectifiedImages
        Same shape and dtype, bicubic; pixels beyond the raw image repeat its border and are False in the mask.

    Raises
    ------
    RectificationError
        When the two views have nothing in common.

    References
    ----------
    Rotations after J.-Y. Bouguet's Camera Calibration Toolbox, as in OpenCV's `stereoRectify`.
    """
    plan = (
        rig.rectification if alpha is None and rig.rectification is not None else plan_rectification(rig, alpha or 0.0)
    )
    images = []
    for image, camera, rotation, centre in (
        (left, rig.left, plan.left_rotation, plan.calibration.cx_px),
        (right, rig.right, plan.right_rotation, plan.calibration.cx_px + plan.calibration.doffs_px),
    ):
        x_px, y_px, seen = rectification_map(camera, rotation, plan.calibration, centre)
        warped, inside = warp(image, x_px, y_px)
        images.append((warped, inside & seen))
    return RectifiedImages(images[0][0], images[1][0], images[0][1], images[1][1], plan)


def plan_rectification(rig: StereoRig, alpha: float = 0.0) -> Rectification:
    """Choose the common plane of a rig and its focal length.

    Parameters
    ----------
    rig : StereoRig
    alpha : float
        0 to 1: from only valid pixels to all pixels.

    Returns
    -------
    Rectification
        Both cameras get one principal point, so that doffs is 0.

    Raises
    ------
    RectificationError
        When alpha is out of range, or the two views have nothing in common.
    """
    if not 0.0 <= alpha <= 1.0:
        raise RectificationError(f"alpha is {alpha:g} and must lie between 0 (only valid pixels) and 1 (all pixels)")
    size = (rig.left.width_px, rig.left.height_px)
    rotations: Any = cv2.stereoRectify(
        rig.left.matrix, np.zeros(4), rig.right.matrix, np.zeros(4), size, rig.rotation,
        np.asarray(rig.translation_m, np.float64).reshape(3, 1), alpha=0,
    )[:2]  # fmt: skip
    inner, outer = [], []
    for camera, rotation in zip((rig.left, rig.right), rotations, strict=True):
        sides = [_view_directions(camera, rotation, side) for side in ("left", "right", "top", "bottom")]
        inner.append((sides[0][:, 0].max(), sides[1][:, 0].min(), sides[2][:, 1].max(), sides[3][:, 1].min()))
        outer.append((sides[0][:, 0].min(), sides[1][:, 0].max(), sides[2][:, 1].min(), sides[3][:, 1].max()))
    kept = np.array(
        [max(r[0] for r in inner), min(r[1] for r in inner), max(r[2] for r in inner), min(r[3] for r in inner)]
    )
    full = np.array(
        [min(r[0] for r in outer), max(r[1] for r in outer), min(r[2] for r in outer), max(r[3] for r in outer)]
    )
    if kept[1] <= kept[0] or kept[3] <= kept[2]:
        raise RectificationError(
            "after rectification the two cameras see nothing in common; check rotation and translation between them"
        )
    extent = np.array([size[0] - 1, size[1] - 1], np.float64)
    focal_inner = float((extent / [kept[1] - kept[0], kept[3] - kept[2]]).max())
    focal_outer = float((extent / [full[1] - full[0], full[3] - full[2]]).min())
    focal = (1.0 - alpha) * focal_inner + alpha * focal_outer
    middle = (1.0 - alpha) * kept.reshape(2, 2).mean(axis=1) + alpha * full.reshape(2, 2).mean(axis=1)
    cx, cy = (float(value) for value in extent / 2.0 - focal * middle)
    baseline = float(np.linalg.norm(rig.translation_m))
    return Rectification(
        np.asarray(rotations[0]), np.asarray(rotations[1]), Calibration(focal, cx, cy, baseline, size[0], size[1])
    )


def rectification_map(
    camera: Camera, rotation: Array, calibration: Calibration, cx_px: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], Mask]:
    """Return where each rectified pixel is read from.

    Parameters
    ----------
    camera : Camera
    rotation : float64 (3, 3)
        `p_rectified = rotation @ p_optical`.
    calibration : Calibration
        Of the rectified pair.
    cx_px : float
        Column of this camera's rectified principal point, px.

    Returns
    -------
    x_px, y_px : float32 (H, W)
        Column and row in the raw image.
    seen : bool (H, W)
        False where the ray lies behind the camera or beyond the angle where the distortion model turns back.
    """
    size = (calibration.width_px, calibration.height_px)
    target = np.array([[calibration.focal_px, 0, cx_px], [0, calibration.focal_px, calibration.cy_px], [0, 0, 1.0]])
    maps: Any
    if camera.model == "equidistant":
        coefficients = np.zeros(4) if not camera.distortion else np.array(camera.distortion)
        maps = cv2.fisheye.initUndistortRectifyMap(camera.matrix, coefficients, rotation, target, size, cv2.CV_32FC1)
    else:
        coefficients = np.array(camera.distortion or (0.0,) * 4)
        maps = cv2.initUndistortRectifyMap(camera.matrix, coefficients, rotation, target, size, cv2.CV_32FC1)
    limit = max_ray_tangent(camera)
    column = np.arange(size[0], dtype=np.float64)[None, :]
    row = np.arange(size[1], dtype=np.float64)[:, None]
    x, y = (column - cx_px) / calibration.focal_px, (row - calibration.cy_px) / calibration.focal_px
    back = rotation.T
    depth = back[2, 0] * x + back[2, 1] * y + back[2, 2]
    across = (back[0, 0] * x + back[0, 1] * y + back[0, 2]) ** 2 + (back[1, 0] * x + back[1, 1] * y + back[1, 2]) ** 2
    seen = (depth > 0.0) & (across <= (limit * depth) ** 2)
    return maps[0], maps[1], seen


def max_ray_tangent(camera: Camera) -> float:
    """Return the tangent of the largest angle to the axis at which the distortion model still grows outwards.

    Beyond it a polynomial folds back into the image and would show the centre a second time.
    """
    if camera.model == "equidistant":
        angle = np.linspace(0.0, np.pi / 2, RADIUS_STEPS)[:-1]
        k = np.array(camera.distortion or (0.0,) * 4)
        image = angle * (1 + k[0] * angle**2 + k[1] * angle**4 + k[2] * angle**6 + k[3] * angle**8)
        radius = np.tan(angle)
    else:
        radius = np.tan(np.linspace(0.0, np.radians(85.0), RADIUS_STEPS))
        k = np.zeros(8)
        k[: min(8, len(camera.distortion))] = camera.distortion[:8]
        square = radius**2
        grown = 1 + square * (k[0] + square * (k[1] + square * k[4]))
        image = radius * grown / (1 + square * (k[5] + square * (k[6] + square * k[7])))
    falling = np.flatnonzero(np.diff(image) <= 0.0)
    return float(radius[falling[0]] if len(falling) else radius[-1])


def rectified_points(points: Array, camera: Camera, rotation: Array, calibration: Calibration, cx_px: float) -> Array:
    """Return where points (N, 2) of the raw image, column and row in px, lie in the rectified one."""
    normal = plane_points(points, camera, rotation)
    return normal * calibration.focal_px + [cx_px, calibration.cy_px]


def plane_points(points: Array, camera: Camera, rotation: Array) -> Array:
    """Return raw image points (N, 2), px, on the plane at focal length 1 of the camera turned by `rotation`."""
    raw = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 2)
    coefficients = np.array(camera.distortion or (0.0,) * 4)
    found: Any
    if camera.model == "equidistant":
        found = cv2.fisheye.undistortPoints(raw, camera.matrix, coefficients)
        outwards = raw - camera.centre_px
        # OpenCV's mark of a point beyond the model; and a ray beyond 90 degrees, whose tangent has the other sign.
        lost = (np.abs(found).max(axis=2) > LOST) | (np.sum(found * outwards, axis=2) < 0.0)
        outwards = outwards / np.maximum(np.abs(outwards).max(axis=2, keepdims=True), 1e-9)
        found = np.where(lost[..., None], outwards * MAX_RAY_TANGENT, found)
    else:
        found = cv2.undistortPoints(raw, camera.matrix, coefficients)
        for _ in range(POLISH):  # OpenCV stops after five steps, up to 0.2 px short at the corners of an image
            rays = np.concatenate([found, np.ones_like(found[..., :1])], axis=2)
            seen: Any = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, coefficients)[0]
            step = (raw - seen) / camera.focal_px
            step = np.where(np.abs(step).max(axis=2, keepdims=True) < MAX_STEP, step, 0.0)
            found = found + step
            if float(np.abs(step).max()) < CONVERGED:
                break
    turned = found.reshape(-1, 2) @ rotation[:, :2].T + rotation[:, 2]
    return np.asarray(turned[:, :2] / turned[:, 2:], np.float64)


def project_points(points: Array, camera: Camera) -> Array:
    """Return where points (N, 3) in the optical frame are seen by a camera, float64 (N, 2) px."""
    still, coefficients = np.zeros(3), np.array(camera.distortion or (0.0,) * 4)
    found: Any
    if camera.model == "equidistant":
        found = cv2.fisheye.projectPoints(points.reshape(1, -1, 3), still, still, camera.matrix, coefficients)[0]
    else:
        found = cv2.projectPoints(points, still, still, camera.matrix, coefficients)[0]
    return np.asarray(found, np.float64).reshape(-1, 2)


def already_rectified(rig: StereoRig) -> Calibration | None:
    """Return the geometry of a rig whose images need no rectification, else None.

    That is a rig without distortion whose rotations and focal lengths move no pixel by more than 0.05 px.
    """
    left, right = rig.left, rig.right
    if left.distortion or right.distortion or "equidistant" in (left.model, right.model):
        return None
    x, y, z = rig.translation_m
    size = max(left.width_px, left.height_px)
    tilt = max(abs(y), abs(z)) / max(abs(x), 1e-12)
    off = [
        *(abs(value - left.focal_px[0]) * 0.5 * size / left.focal_px[0] for value in (*left.focal_px, *right.focal_px)),
        abs(left.centre_px[1] - right.centre_px[1]),
        float(np.abs(rig.rotation - np.eye(3)).max()) * left.focal_px[0],
        tilt * left.focal_px[0],
    ]
    if max(off) > SAME_PX:
        return None
    doffs = right.centre_px[0] - left.centre_px[0]
    return Calibration(left.focal_px[0], *left.centre_px, abs(x), left.width_px, left.height_px, doffs)


def _view_directions(camera: Camera, rotation: Array, side: str) -> Array:
    """Return where one side of the raw image lies on the rectified plane at focal length 1, float64 (N, 2)."""
    w, h = camera.width_px - 1, camera.height_px - 1
    along = np.linspace(0.0, 1.0, BORDER_SAMPLES)
    fixed = {"left": (0.0, None), "right": (w, None), "top": (None, 0.0), "bottom": (None, h)}[side]
    x = np.full(BORDER_SAMPLES, fixed[0]) if fixed[0] is not None else along * w
    y = np.full(BORDER_SAMPLES, fixed[1]) if fixed[1] is not None else along * h
    plane = plane_points(np.column_stack([x, y]), camera, np.eye(3))
    plane = plane * np.minimum(1.0, MAX_RAY_TANGENT / np.maximum(np.abs(plane).max(axis=1, keepdims=True), 1e-9))
    turned = plane @ rotation[:, :2].T + rotation[:, 2]
    return np.clip(turned[:, :2] / turned[:, 2:], -MAX_RAY_TANGENT, MAX_RAY_TANGENT)
