"""Slope, roughness and step of an elevation grid."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.types import Scene

MAX_WINDOW_CELLS = 101


class ComputeSlopeParams(OperatorParams):
    """Parameters of `compute_slope`."""

    window_m: float = Field(0.25, gt=0.0, le=100.0, description="Edge of the square patch, about a wheel or robot, m")
    min_fraction: float = Field(0.5, ge=0.1, le=1.0, description="Smallest known fraction of the patch")


def compute_slope(scene: Scene, params: ComputeSlopeParams) -> Scene:
    """Fit a plane to the patch about every known cell.

    Parameters
    ----------
    scene : Scene
        Needs `elevation`.
    params : ComputeSlopeParams

    Returns
    -------
    Scene
        With layers, float32, NaN where unknown: `slope_deg` (tilt of the plane), `roughness_m` (root mean square
        distance in z from it) and `step_m` (highest less lowest cell of the patch).

    Raises
    ------
    OperatorError
        Without an elevation grid, or when the patch is smaller than 3 cells or larger than 101.

    References
    ----------
    S. Goldberg, M. Maimone and L. Matthies, "Stereo vision and rover navigation software for planetary exploration",
    IEEE Aerospace Conference 2002.
    """
    if scene.elevation is None:
        raise OperatorError("there is no elevation grid; run reconstruction.grid_elevation first")
    grid = scene.elevation
    radius = round((params.window_m / grid.cell_m - 1.0) / 2.0)
    size = 2 * radius + 1
    if size < 3 or size > MAX_WINDOW_CELLS:
        raise OperatorError(
            f"a patch of {params.window_m:g} m is {size} cells of {grid.cell_m:g} m wide and 3 to {MAX_WINDOW_CELLS} "
            f"are possible; use a window between {3 * grid.cell_m:g} and {MAX_WINDOW_CELLS * grid.cell_m:g} m"
        )
    z = np.asarray(grid.layers["elevation"], np.float64)
    known = np.isfinite(z)
    slope, rough, enough = _plane_fit(z, known, radius, grid.cell_m, params.min_fraction)
    kernel = np.ones((size, size), np.uint8)
    high = cv2.dilate(np.where(known, z, -np.inf), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=-np.inf)
    low = cv2.erode(np.where(known, z, np.inf), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=np.inf)
    with np.errstate(invalid="ignore"):
        step = high - low
    layers = dict(grid.layers)
    for name, layer in (("slope_deg", slope), ("roughness_m", rough), ("step_m", step)):
        layers[name] = np.where(enough, layer, np.nan).astype(np.float32)
    return replace(scene, elevation=replace(grid, layers=layers))


def _plane_fit(
    z: NDArray[np.float64], known: NDArray[np.bool_], radius: int, cell_m: float, min_fraction: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return slope in deg, residual in m and where both are known, each (H, W)."""
    offset = np.arange(-radius, radius + 1) * cell_m
    x, y = np.meshgrid(offset, offset)
    one = np.ones_like(x)
    level = float(np.mean(z[known])) if known.any() else 0.0  # near zero the sums of squares keep their digits
    filled = np.where(known, z - level, 0.0)
    mask = known.astype(np.float64)

    def total(image: NDArray[np.float64], kernel: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(cv2.filter2D(image, cv2.CV_64F, kernel, borderType=cv2.BORDER_CONSTANT))

    n = np.maximum(total(mask, one), 1.0)
    mx, my, mz = total(mask, x) / n, total(mask, y) / n, total(filled, one) / n
    xx, yy = total(mask, x * x) / n - mx * mx, total(mask, y * y) / n - my * my
    xy = total(mask, x * y) / n - mx * my
    xz, yz = total(filled, x) / n - mx * mz, total(filled, y) / n - my * mz
    zz = total(filled * filled, one) / n - mz * mz
    determinant = xx * yy - xy * xy
    enough = known & (n >= max(3.0, min_fraction * one.size)) & (determinant > 1e-6 * cell_m**4)
    safe = np.where(enough, determinant, 1.0)
    a, b = (xz * yy - yz * xy) / safe, (yz * xx - xz * xy) / safe
    residual = np.sqrt(np.maximum(zz - a * xz - b * yz, 0.0))
    return np.degrees(np.arctan(np.hypot(a, b))), residual, enough


OPERATOR = Operator(
    name="reconstruction.compute_slope",
    slot="terrain",
    params=ComputeSlopeParams,
    function=compute_slope,
    cost=Cost(fixed_ms=5.0, ns_per_pixel=20.0),
    summary="Adds slope, roughness and step of the patch about every cell.",
    suits="Traversability of known terrain; cells near the border of the known terrain see only half a patch.",
)
