"""Fit two fisheye cameras and the pose between them to views of a chessboard."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.rectification.chessboard import BoardView, Chessboard
from modules.types import Camera, StereoRig

Array = NDArray[np.float64]

OWN = 8  # parameters of one camera: focal lengths, principal point, four coefficients
POSE = 6  # of a pose: rotation vector and translation
RIG = 2 * OWN + POSE  # parameters before those of the views
HALF_ANGLES_DEG = (35.0, 60.0, 90.0)  # of the image's half width, where a fit starts; the best one is kept
LARGEST_ANGLE = np.radians(85.0)  # of a ray on the plane of a start
MAX_STEPS = 100
FIRST_DAMPING, MOST_DAMPING, DAMPING_FACTOR = 1e-3, 1e12, 10.0
LEAST_CURVATURE = 1e-12  # of a parameter that changes nothing
CONVERGED = 1e-9  # of the sum of squares that a step gains


class _Equations:
    """Normal equations of a step, summed up by blocks, which are too small for threads of the BLAS library.

    Attributes
    ----------
    residuals : list of float64 (2 N,)
        Projections less corners, px, by view and image.
    normal, slope : float64 (P, P), (P,)
        Squares of the derivatives, and their product with the residuals.
    """

    def __init__(self, parameters: int) -> None:
        self.residuals: list[Array] = []
        self.normal, self.slope = np.zeros((parameters, parameters)), np.zeros(parameters)

    def add(self, residuals: Array, derivatives: Array, *places: slice) -> None:
        """Add residuals whose derivatives (2 N, Q) are by the parameters at these places."""
        index = np.concatenate([np.arange(place.start, place.stop) for place in places])
        self.residuals.append(residuals)
        self.normal[np.ix_(index, index)] += derivatives.T @ derivatives
        self.slope[index] += derivatives.T @ residuals

    @property
    def cost(self) -> float:
        """Sum of the squared residuals, px^2."""
        return float(sum(part @ part for part in self.residuals))


def fit_fisheye(
    views: Sequence[BoardView], board: Chessboard, size: tuple[int, int]
) -> tuple[StereoRig, tuple[float, float], Array]:
    """Fit cameras of the model of Kannala and Brandt by least squares of all corners in both images.

    Parameters
    ----------
    views : sequence of BoardView
    board : Chessboard
    size : (int, int)
        Width and height of the images, px.

    Returns
    -------
    StereoRig
        Cameras of the model `equidistant`.
    (float, float)
        Standard deviation of the focal length, left and right, px.
    float64 (N,)
        Root mean square reprojection error of each view over both images, px.

    References
    ----------
    J. Kannala and S. Brandt, A generic camera model and calibration method for conventional, wide-angle, and fish-eye
    lenses, PAMI 28(8), 2006; the form of OpenCV's `fisheye` module.
    """
    points = board.points_m().astype(np.float64).reshape(1, -1, 3)
    seen = [np.array([getattr(view, side) for view in views], np.float64) for side in ("left_px", "right_px")]
    singles = [_single(points, corners, size) for corners in seen]
    poses = [x[OWN:].reshape(-1, POSE) for x in singles]
    start = np.concatenate([singles[0][:OWN], singles[1][:OWN], _between(*poses), poses[0].ravel()])
    x, solved = _solve(lambda x: _of_both(x, points, seen), start)
    squares = np.array([part @ part for part in solved.residuals]).reshape(len(views), 2) / points.shape[1]
    turn, shift = x[2 * OWN : RIG - 3], x[RIG - 3 : RIG]
    rig = StereoRig(
        _camera(x[:OWN], size),
        _camera(x[OWN : 2 * OWN], size),
        np.asarray(cv2.Rodrigues(turn)[0]),
        (float(shift[0]), float(shift[1]), float(shift[2])),
    )
    freedom = max(2 * points.shape[1] * len(solved.residuals) - len(x), 1)
    first, second = (_solved(solved.normal, np.eye(len(x))[focal])[focal] for focal in (0, OWN))
    sigma = float(np.sqrt(solved.cost / freedom * first)), float(np.sqrt(solved.cost / freedom * second))
    return rig, sigma, np.sqrt(np.mean(squares, axis=1))


def _solve(model: Callable[[Array], _Equations], x: Array) -> tuple[Array, _Equations]:
    """Return the least squares of a model and its equations there, after Levenberg and Marquardt."""
    at, damping = model(x), FIRST_DAMPING
    for _ in range(MAX_STEPS):
        damped = at.normal + damping * np.diag(np.maximum(np.diag(at.normal), LEAST_CURVATURE))
        proposed = x - _solved(damped, at.slope)
        found = model(proposed)
        if not found.cost < at.cost:  # a step that is no number is refused, too
            damping *= DAMPING_FACTOR
            if damping > MOST_DAMPING:
                break
            continue
        gained = at.cost - found.cost
        x, at, damping = proposed, found, damping / DAMPING_FACTOR
        if gained <= CONVERGED * at.cost:
            break
    return x, at


def _solved(matrix: Array, right: Array) -> Array:
    """Return `matrix^-1 right` of a positive matrix; by OpenCV, because numpy's threads cost more than they gain."""
    column = right.reshape(-1, 1)
    ok, found = cv2.solve(matrix, column, flags=cv2.DECOMP_CHOLESKY)
    if not ok:
        found = cv2.solve(matrix, column, flags=cv2.DECOMP_SVD)[1]
    return np.ravel(np.asarray(found, np.float64))


def _camera(own: Array, size: tuple[int, int]) -> Camera:
    fx, fy, cx, cy, *k = (float(value) for value in own)
    return Camera((fx, fy), (cx, cy), size[0], size[1], tuple(k), "equidistant")


def _seen(own: Array, pose: Array, points: Array) -> tuple[Array, Array]:
    """Return where the points are seen, (2 N,) px, and its derivatives by camera and pose, (2 N, 14)."""
    matrix = np.array([[own[0], 0.0, own[2]], [0.0, own[1], own[3]], [0.0, 0.0, 1.0]])
    made: Any = cv2.fisheye.projectPoints(points, pose[:3], pose[3:], matrix, own[4:])
    return np.ravel(np.asarray(made[0], np.float64)), np.asarray(made[1], np.float64)[:, : OWN + POSE]


def _single(points: Array, corners: Array, size: tuple[int, int]) -> Array:
    """Fit one camera and the pose of the board in each view; the best of several starts."""

    def model(x: Array) -> _Equations:
        equations = _Equations(len(x))
        for index, view in enumerate(corners):
            mine = slice(OWN + index * POSE, OWN + (index + 1) * POSE)
            image, by = _seen(x[:OWN], x[mine], points)
            equations.add(image - view.ravel(), by, slice(0, OWN), mine)
        return equations

    found = []
    for half in HALF_ANGLES_DEG:
        focal = 0.5 * size[0] / np.radians(half)
        own = np.array([focal, focal, 0.5 * (size[0] - 1), 0.5 * (size[1] - 1), 0.0, 0.0, 0.0, 0.0])
        found.append(_solve(model, np.concatenate([own, *(_pose(own, points, view) for view in corners)])))
    return np.asarray(min(found, key=lambda solved: solved[1].cost)[0])


def _of_both(x: Array, points: Array, seen: Sequence[Array]) -> _Equations:
    """Return the equations of both cameras, the pose between them and the poses of the board."""
    equations = _Equations(len(x))
    own, other, between = slice(0, OWN), slice(OWN, 2 * OWN), slice(2 * OWN, RIG)
    for index, (in_left, in_right) in enumerate(zip(*seen, strict=True)):
        mine = slice(RIG + index * POSE, RIG + (index + 1) * POSE)
        image, by = _seen(x[own], x[mine], points)
        equations.add(image - in_left.ravel(), by, own, mine)
        made: Any = cv2.composeRT(x[mine][:3], x[mine][3:], x[between][:3], x[between][3:])
        turn, shift, *chain = made
        by_board, by_rig = (np.block([[chain[i], chain[i + 1]], [chain[i + 4], chain[i + 5]]]) for i in (0, 2))
        image, by = _seen(x[other], np.concatenate([np.ravel(turn), np.ravel(shift)]), points)
        derivatives = np.concatenate([by[:, :OWN], by[:, OWN:] @ by_board, by[:, OWN:] @ by_rig], axis=1)
        equations.add(image - in_right.ravel(), derivatives, other, mine, between)
    return equations


def _pose(own: Array, points: Array, corners: Array) -> Array:
    """Return the pose of the board, for a camera whose parameters are about right."""
    offset = (corners - own[2:4]) / own[:2]
    angle = np.linalg.norm(offset, axis=1, keepdims=True)
    plane = offset * np.tan(np.minimum(angle, LARGEST_ANGLE)) / np.maximum(angle, 1e-9)
    made: Any = cv2.solvePnP(points[0], plane, np.eye(3), np.zeros(4))
    return np.concatenate([np.ravel(made[1]), np.ravel(made[2])])


def _between(left: Array, right: Array) -> Array:
    """Return the pose of the right camera against the left one, the median over the views."""
    found = []
    for a, b in zip(left, right, strict=True):
        turn = np.asarray(cv2.Rodrigues(b[:3])[0]) @ np.asarray(cv2.Rodrigues(a[:3])[0]).T
        found.append(np.concatenate([np.ravel(cv2.Rodrigues(turn)[0]), b[3:] - turn @ a[3:]]))
    return np.asarray(np.median(found, axis=0))
