"""Calibrate a stereo camera from views of a chessboard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.rectification.chessboard import BoardView, Chessboard
from modules.rectification.fisheye import fit_fisheye
from modules.rectification.rectify import (
    RectificationError,
    plan_rectification,
    plane_points,
    project_points,
    rectified_points,
)
from modules.types import Camera, StereoRig

MIN_VIEWS = 5
OUTLIER_FACTOR = 2.5  # a view is dropped when its error is this many times the median
OUTLIER_FLOOR_PX = 0.3  # and above this
MAX_DROPPED = 0.4  # fraction of the views
Model = Literal["radtan", "equidistant"]
GRID = 8  # coverage counts cells of a grid of 8 x 8
REGION = 2  # cells; the corner of an image is seen where a corner of the board lies within so many of its own


@dataclass(frozen=True)
class ViewErrors:
    """How well one view of the board agrees with the calibration.

    Attributes
    ----------
    name : str
    reprojection_px : float
        Root mean square distance of corners and their projections, over both images.
    epipolar_px : float
        Root mean square row difference of corresponding corners after rectification.
    used : bool
        False where the view was dropped as an outlier.
    """

    name: str
    reprojection_px: float
    epipolar_px: float
    used: bool


@dataclass(frozen=True)
class RigCalibration:
    """A calibrated rig.

    Attributes
    ----------
    rig : StereoRig
    errors : tuple of ViewErrors
        In the order of the views.
    sigma_focal_px : (float, float)
        Standard deviation of the focal length, left and right.
    coverage : (float, float)
        Fraction of the cells of an 8 x 8 grid that hold corners of a used view, left and right.
    blind : (tuple of str, tuple of str)
        Corners of the left and of the right image (`top left` and so on) in whose quarter of width and height no used
        view has a corner: the distortion there is extrapolated.
    """

    rig: StereoRig
    errors: tuple[ViewErrors, ...]
    sigma_focal_px: tuple[float, float]
    coverage: tuple[float, float]
    blind: tuple[tuple[str, ...], tuple[str, ...]]

    def total(self, which: str) -> float:
        """Return the root mean square of `reprojection_px` or `epipolar_px` over the used views."""
        return float(np.sqrt(np.mean([getattr(error, which) ** 2 for error in self.errors if error.used])))


class CalibrationFailed(ValueError):
    """The views do not give a calibration; the message names the value, the limit and the remedy."""


def calibrate_rig(
    views: Sequence[BoardView], board: Chessboard, size: tuple[int, int], model: Model = "radtan"
) -> RigCalibration:
    """Calibrate both cameras and the pose between them, and drop views that do not agree.

    Each camera is calibrated by itself, then both together; the view with the largest error is dropped
    while it is above 2.5 times the median and above 0.3 px, and everything is fitted again.

    Parameters
    ----------
    views : sequence of BoardView
        At least 5.
    board : Chessboard
    size : (int, int)
        Width and height of the images, px.
    model : {"radtan", "equidistant"}
        Brown's with 5 coefficients, or the fisheye model of Kannala and Brandt with 4.

    Returns
    -------
    RigCalibration

    Raises
    ------
    CalibrationFailed
        Too few views, or a result that cannot be.

    References
    ----------
    Z. Zhang, A flexible new technique for camera calibration, PAMI 22(11), 2000.
    """
    if len(views) < MIN_VIEWS:
        raise CalibrationFailed(
            f"the board was found in {len(views)} pairs and calibration needs {MIN_VIEWS}; 15 or more are better: "
            f"check that it has {board.columns}x{board.rows} inner corners (--pattern) and is whole in both images"
        )
    fit = fit_fisheye if model == "equidistant" else _fit
    used = list(range(len(views)))
    while True:
        chosen = [views[index] for index in used]
        rig, sigma, reprojection = fit(chosen, board, size)
        worst = int(np.argmax(reprojection))
        limit = max(OUTLIER_FLOOR_PX, OUTLIER_FACTOR * float(np.median(reprojection)))
        enough = len(used) - 1 >= max(MIN_VIEWS, int(np.ceil((1.0 - MAX_DROPPED) * len(views))))
        if reprojection[worst] <= limit or not enough:
            break
        used.pop(worst)
    if rig.translation_m[0] > 0.0:
        raise CalibrationFailed(
            f"the right camera stands {rig.translation_m[0]:.3f} m to the left of the left one; exchange the images"
        )
    of_used = dict(zip(used, reprojection, strict=True))
    errors = tuple(
        ViewErrors(
            view.name,
            float(of_used[index]) if index in of_used else _reprojection_of(view, board, rig),
            epipolar,
            index in of_used,
        )
        for index, (view, epipolar) in enumerate(zip(views, _epipolar(views, rig), strict=True))
    )
    left, right = (_seen([getattr(views[i], side) for i in used], size) for side in ("left_px", "right_px"))
    coverage = float(left.mean()), float(right.mean())
    return RigCalibration(rig, errors, sigma, coverage, (_blind(left), _blind(right)))


def _fit(
    views: Sequence[BoardView], board: Chessboard, size: tuple[int, int]
) -> tuple[StereoRig, tuple[float, float], NDArray[np.float64]]:
    """Return the rig, the standard deviation of both focal lengths, and the error of each view, px."""
    points = [board.points_m()] * len(views)
    start: list[Any] = []
    sigma: list[float] = []
    for side in ("left_px", "right_px"):
        corners = [np.ascontiguousarray(getattr(view, side)).reshape(-1, 1, 2) for view in views]
        single: Any = cv2.calibrateCameraExtended(points, corners, size, np.zeros((3, 3)), np.zeros(5))
        start += [single[1], single[2]]
        sigma.append(float(np.ravel(single[5])[0]))
    left, right = ([getattr(view, side).reshape(-1, 1, 2) for view in views] for side in ("left_px", "right_px"))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-7)
    guess = cv2.CALIB_USE_INTRINSIC_GUESS
    made: Any = cv2.stereoCalibrateExtended(
        points, left, right, start[0], start[1], start[2], start[3], size, np.eye(3), np.zeros((3, 1)),
        flags=guess, criteria=criteria,
    )  # fmt: skip
    _, m1, d1, m2, d2, rotation, translation = made[:7]
    x, y, z = (float(value) for value in np.ravel(translation))
    rig = StereoRig(_camera(m1, d1, size), _camera(m2, d2, size), np.asarray(rotation), (x, y, z))
    errors = np.sqrt(np.mean(np.asarray(made[-1], np.float64).reshape(len(views), 2) ** 2, axis=1))
    return rig, (sigma[0], sigma[1]), errors


def _camera(matrix: NDArray[np.float64], distortion: NDArray[np.float64], size: tuple[int, int]) -> Camera:
    return Camera(
        (float(matrix[0, 0]), float(matrix[1, 1])),
        (float(matrix[0, 2]), float(matrix[1, 2])),
        size[0],
        size[1],
        tuple(float(value) for value in np.ravel(distortion)),
    )


def _reprojection_of(view: BoardView, board: Chessboard, rig: StereoRig) -> float:
    """Return the error of a view that took no part in the fit, its pose fitted to the left image."""
    points = board.points_m().astype(np.float64)
    plane = plane_points(view.left_px.astype(np.float64), rig.left, np.eye(3))
    pose: Any = cv2.solvePnP(points, plane, np.eye(3), np.zeros(4))
    in_board = np.asarray(cv2.Rodrigues(pose[1])[0]), np.ravel(pose[2])
    squares = []
    for camera, seen, turn, shift in (
        (rig.left, view.left_px, *in_board),
        (rig.right, view.right_px, rig.rotation @ in_board[0], rig.rotation @ in_board[1] + rig.translation_m),
    ):
        squares.append(np.sum((project_points(points @ turn.T + shift, camera) - seen) ** 2, axis=1))
    return float(np.sqrt(np.mean(squares)))


def _epipolar(views: Sequence[BoardView], rig: StereoRig) -> list[float]:
    """Return the root mean square row difference of each view after rectification, px of the rectified images."""
    try:
        plan = plan_rectification(rig)
    except RectificationError as error:
        raise CalibrationFailed(f"the calibrated rig cannot be rectified: {error}") from error
    found = []
    for view in views:
        left, right = (
            rectified_points(corners.astype(np.float64), camera, rotation, plan.calibration, plan.calibration.cx_px)
            for corners, camera, rotation in (
                (view.left_px, rig.left, plan.left_rotation),
                (view.right_px, rig.right, plan.right_rotation),
            )
        )
        found.append(float(np.sqrt(np.mean((left[:, 1] - right[:, 1]) ** 2))))
    return found


def _seen(corners: list[NDArray[np.float32]], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the cells of the image, bool (8, 8), that hold corners."""
    points = np.concatenate(corners)
    column = np.clip(points[:, 0] * GRID / size[0], 0, GRID - 1).astype(int)
    row = np.clip(points[:, 1] * GRID / size[1], 0, GRID - 1).astype(int)
    seen = np.zeros((GRID, GRID), bool)
    seen[row, column] = True
    return seen


def _blind(seen: NDArray[np.bool_]) -> tuple[str, ...]:
    near, far = slice(None, REGION), slice(-REGION, None)
    places = {
        "top left": (near, near),
        "top right": (near, far),
        "bottom left": (far, near),
        "bottom right": (far, far),
    }
    return tuple(name for name, cells in places.items() if not seen[cells].any())
