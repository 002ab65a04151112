"""Frame from the ground itself, where no attitude was measured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.frames import level_from_body, roll_pitch_from_up
from modules.primitives.planes import least_squares_plane, robust_plane
from modules.types import Attitude, Calibration, GroundPlane, Scene

MAX_POINTS = 20_000  # pixels that take part in the fit
MIN_POINTS = 100
BLOCKS = 8  # image sectors of the jackknife: terrain, not pixel noise, limits the accuracy


class LevelByGroundPlaneParams(OperatorParams):
    """Parameters of `level_by_ground_plane`."""

    max_range_m: float = Field(15.0, gt=0.0, le=1000.0, description="Depth up to which pixels take part, m")
    sigma_px: float = Field(0.5, gt=0.0, le=10.0, description="Standard deviation of the disparity, px")
    relief_fraction: float = Field(
        0.1, ge=0.0, le=0.5, description="Height of terrain about the plane, as a fraction of the camera height"
    )
    min_inlier_fraction: float = Field(
        0.3, ge=0.05, le=1.0, description="Smallest fraction of the pixels that must lie on the plane"
    )
    ground_slope_sigma_deg: float = Field(
        2.0, ge=0.0, le=45.0, description="Standard deviation of the real slope of the ground, unknown to the fit, deg"
    )
    max_tilt_deg: float = Field(60.0, ge=1.0, le=89.0, description="Largest tilt of the ground against the body, deg")


def level_by_ground_plane(scene: Scene, params: LevelByGroundPlaneParams) -> Scene:
    """Fit the dominant plane and make it level: it becomes z = 0, and roll and pitch follow from it.

    The fit is made in disparity space, where a plane is linear in column and row and the noise is the same everywhere;
    a fit to points would be biased, because their noise lies along the rays. Where the scene has an attitude with a
    stated uncertainty (an accelerometer of a moving vehicle, a rover assumed to stand level), the two are weighed
    against each other by their variances, and its yaw is kept.

    Parameters
    ----------
    scene : Scene
        Needs `calibration`.
    params : LevelByGroundPlaneParams

    Returns
    -------
    Scene
        With `ground` (`normal` is up in body axes, `height_m` is the height of the body origin above the plane) and an
        `attitude`. Without a prior attitude the real slope of the ground is lost: it is level by definition.

    Raises
    ------
    OperatorError
        Without calibration, with too few pixels, or when no plane below the camera explains enough of them.

    References
    ----------
    R. Labayrade, D. Aubert and J.-P. Tarel, "Real time obstacle detection in stereovision on non flat road geometry
    through v-disparity representation", IEEE Intelligent Vehicles Symposium 2002.
    """
    if scene.calibration is None:
        raise OperatorError(
            "the ground plane needs a calibration and the pair has none; give focal length and baseline"
        )
    calibration = scene.calibration
    xy, shifted = _near_pixels(scene.disparity.disparity_px, calibration, params.max_range_m)
    if len(shifted) < MIN_POINTS:
        raise OperatorError(
            f"{len(shifted)} pixels are nearer than {params.max_range_m:g} m and the ground plane needs {MIN_POINTS}; "
            "raise max_range_m or use reconstruction.assume_level"
        )
    tolerance = np.hypot(2.5 * params.sigma_px, params.relief_fraction * shifted)
    fit = robust_plane(xy, shifted, tolerance)
    if fit is None:
        raise OperatorError(
            "the near pixels lie on one image line, so no ground plane; use reconstruction.assume_level"
        )
    fraction = float(fit.inliers.mean())
    up, height = _up_and_height(fit.coefficients, scene)
    tilt = math.degrees(math.acos(min(1.0, max(-1.0, float(up[2])))))
    if fraction < params.min_inlier_fraction:
        raise OperatorError(
            f"the best plane explains {fraction:.2f} of the near pixels, below {params.min_inlier_fraction:g}; "
            "the ground is not flat enough: give an attitude or use reconstruction.assume_level"
        )
    if tilt > params.max_tilt_deg:
        raise OperatorError(
            f"the dominant plane is tilted by {tilt:.0f} deg against the body, above {params.max_tilt_deg:g} deg; "
            "it is a wall or the mount is wrong: give an attitude or use reconstruction.assume_level"
        )
    inside = fit.inliers
    sigma = _tilt_sigma(xy[inside], shifted[inside], tolerance[inside], scene)
    camera_height = height + float(up @ np.asarray(scene.mount.translation_m))
    heights = camera_height * (fit.at(xy[inside, 0], xy[inside, 1]) / shifted[inside] - 1.0)
    ground = GroundPlane(
        normal=(float(up[0]), float(up[1]), float(up[2])),
        height_m=height,
        sigma_tilt_rad=sigma,
        residual_m=float(np.sqrt(np.mean(heights**2))),
        inlier_fraction=fraction,
    )
    # The jackknife knows how well the plane is determined, not how far the ground itself is from level.
    total = math.hypot(sigma, math.radians(params.ground_slope_sigma_deg))
    return replace(scene, ground=ground, attitude=_weighed(scene.attitude, up, total))


def _weighed(prior: Attitude | None, up: NDArray[np.float64], sigma_rad: float) -> Attitude:
    """Return the attitude at which `up` (3,) points up, weighed against one that states its uncertainty."""
    if prior is None or prior.sigma_rad == 0.0 or sigma_rad == 0.0:
        roll, pitch = roll_pitch_from_up(up)
        return Attitude(roll_rad=roll, pitch_rad=pitch, sigma_rad=sigma_rad)
    weights = 1.0 / prior.sigma_rad**2, 1.0 / sigma_rad**2
    prior_up = level_from_body(prior)[2]
    both = weights[0] * prior_up + weights[1] * up
    roll, pitch = roll_pitch_from_up(both / np.linalg.norm(both))
    return Attitude(roll, pitch, prior.yaw_rad, 1.0 / math.sqrt(sum(weights)))


def _near_pixels(
    disparity: NDArray[np.float32], calibration: Calibration, max_range_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return normalised ray coordinates (N, 2) and disparity + doffs (N,) of an even subset of the near pixels."""
    smallest = max(0.5, calibration.focal_px * calibration.baseline_m / max_range_m)
    with np.errstate(invalid="ignore"):
        rows, columns = np.nonzero(disparity + calibration.doffs_px >= smallest)
    step = max(1, len(rows) // MAX_POINTS)
    rows, columns = rows[::step], columns[::step]
    x = (columns - calibration.cx_px) / calibration.focal_px
    y = (rows - calibration.cy_px) / calibration.focal_px
    return np.column_stack([x, y]), disparity[rows, columns].astype(np.float64) + calibration.doffs_px


def _up_and_height(coefficients: NDArray[np.float64], scene: Scene) -> tuple[NDArray[np.float64], float]:
    """Turn d + doffs = A . (x, y, 1) into the up vector (3,) in body axes and the height of the body origin, m."""
    if scene.calibration is None:  # checked by the caller
        raise OperatorError("no calibration")
    length = float(np.linalg.norm(coefficients))
    if length == 0.0:
        raise OperatorError("the disparity is 0 everywhere, so no ground plane; use reconstruction.assume_level")
    up = -scene.mount.rotation @ (coefficients / length)
    camera_height = scene.calibration.focal_px * scene.calibration.baseline_m / length
    return up, camera_height - float(up @ np.asarray(scene.mount.translation_m))


def _tilt_sigma(
    xy: NDArray[np.float64], shifted: NDArray[np.float64], tolerance: NDArray[np.float64], scene: Scene
) -> float:
    """Jackknife over image sectors, so that relief that many pixels share counts once; rad."""
    order = np.argsort(xy[:, 0], kind="stable")
    tilts = []
    for block in np.array_split(order, BLOCKS):
        keep = np.ones(len(xy), bool)
        keep[block] = False
        plane = least_squares_plane(xy[keep], shifted[keep], 1.0 / tolerance[keep] ** 2)
        tilts.append(roll_pitch_from_up(_up_and_height(plane, scene)[0]))
    spread = np.var(np.asarray(tilts), axis=0) * (BLOCKS - 1)
    return float(np.sqrt(spread.max()))


OPERATOR = Operator(
    name="reconstruction.level_by_ground_plane",
    slot="frame",
    params=LevelByGroundPlaneParams,
    function=level_by_ground_plane,
    cost=Cost(fixed_ms=30.0, ns_per_pixel=30.0),
    summary="Fits the dominant ground plane and takes it as level, or weighs it against an uncertain attitude.",
    suits="Without a sure attitude, where most near pixels are gently rolling ground; hides its mean slope.",
    needs=("calibration",),
)
