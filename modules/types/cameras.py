"""Calibrations and rigs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Calibration:
    """Geometry of a rectified pair.

    Depth is `Z = focal_px * baseline_m / (d + doffs_px)`, where doffs is the right principal point's column minus the
    left one's. Pixel (column u, row v) of the left image looks along `((u - cx) / f, (v - cy) / f, 1)`.
    """

    focal_px: float
    cx_px: float
    cy_px: float
    baseline_m: float
    width_px: int
    height_px: int
    doffs_px: float = 0.0


@dataclass(frozen=True)
class Camera:
    """One camera as it is, before rectification.

    Attributes
    ----------
    focal_px, centre_px : (float, float)
        Along columns and rows; pixel centres have whole coordinates.
    width_px, height_px : int
    distortion : tuple of float
        Coefficients of `model`; empty for none.
    model : {"radtan", "equidistant"}
        `radtan` is Brown's (k1, k2, p1, p2[, k3[, k4, k5, k6[, ...]]], the order of OpenCV), `equidistant` the fisheye
        model of Kannala and Brandt (k1, k2, k3, k4).
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    width_px: int
    height_px: int
    distortion: tuple[float, ...] = ()
    model: Literal["radtan", "equidistant"] = "radtan"

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Camera matrix (3, 3)."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Rectification:
    """How two cameras are turned into a parallel rig: `p_rectified = rotation @ p_optical` for each.

    Attributes
    ----------
    left_rotation, right_rotation : float64 (3, 3)
    calibration : Calibration
        Of the rectified pair.
    """

    left_rotation: NDArray[np.float64]
    right_rotation: NDArray[np.float64]
    calibration: Calibration


@dataclass(frozen=True)
class StereoRig:
    """Two cameras as they are: `p_right = rotation @ p_left + translation_m`, both optical.

    Attributes
    ----------
    left, right : Camera
    rotation : float64 (3, 3)
    translation_m : (float, float, float)
        The first component is negative where the right camera stands to the right.
    rectification : Rectification or None
        The one that the calibration file prescribes; None leaves the choice.
    """

    left: Camera
    right: Camera
    rotation: NDArray[np.float64]
    translation_m: tuple[float, float, float]
    rectification: Rectification | None = None
