"""Elevation grid from points."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.types import ElevationMap, Scene

MAD_TO_SIGMA = 1.4826
VALUE_BITS = 32  # a range of 100 m in steps of 0.02 um; 31 bits are left for the cell


class GridElevationParams(OperatorParams):
    """Parameters of `grid_elevation`."""

    cell_m: float = Field(0.05, ge=0.001, le=100.0, description="Edge of a cell, m")
    method: Literal["mean", "median"] = Field(
        "mean", description="Inverse-variance mean without outliers, or median; of the z in a cell"
    )
    outlier_sigma: float = Field(
        3.0, ge=1.0, le=100.0, description="The mean leaves out points farther from the cell's median, in sigma"
    )
    correlated_px: float = Field(
        16.0, ge=1.0, le=1000.0, description="Neighbouring pixels that share one disparity error, for the sigma only"
    )
    min_points: int = Field(1, ge=1, le=1000, description="Fewest points in a known cell")
    max_cells: int = Field(4_000_000, ge=100, le=100_000_000, description="Most cells of the grid")


def grid_elevation(scene: Scene, params: GridElevationParams) -> Scene:
    """Average the points of every cell.

    Parameters
    ----------
    scene : Scene
        Needs `points`.
    params : GridElevationParams

    Returns
    -------
    Scene
        With `elevation`: layers `elevation` float32 m (NaN unknown), `sigma_m` float32 m (disparity noise by the
        effective number of points, or their spread if larger, and the attitude's share), `count` int32.

    Raises
    ------
    OperatorError
        Without points, or when the grid would have more than `max_cells` cells.

    Notes
    -----
    Matched neighbours share their errors: sigma divides by the square root of count / `correlated_px`, not of count.
    """
    points = scene.points
    if points is None or len(points) == 0:
        raise OperatorError("there are no points to grid; triangulate a disparity map and widen the gates first")
    xyz = points.xyz_m.astype(np.float64)
    first = np.floor(xyz[:, :2].min(axis=0) / params.cell_m)
    last = np.floor(xyz[:, :2].max(axis=0) / params.cell_m)
    columns, rows = (last - first + 1.0).tolist()
    if columns * rows > params.max_cells:
        larger = params.cell_m * float(np.sqrt(columns * rows / params.max_cells))
        raise OperatorError(
            f"a grid of {columns:.0f}x{rows:.0f} cells of {params.cell_m:g} m exceeds {params.max_cells} cells; "
            f"use cells of {larger * 1.01:.2g} m or more, or a smaller range"
        )
    shape = (int(rows), int(columns))
    index = (np.floor(xyz[:, :2] / params.cell_m) - first).astype(np.int64)
    cell = index[:, 1] * shape[1] + index[:, 0]
    cells = shape[0] * shape[1]
    variance = np.full(len(points), 1e-4)
    if points.covariance_m2 is not None:
        variance = np.maximum(points.covariance_m2[:, 5].astype(np.float64), 1e-10)
    z = xyz[:, 2]
    median = _grouped_median(cell, z, cells)
    deviation = np.abs(z - median[cell])
    spread = MAD_TO_SIGMA * _grouped_median(cell, deviation, cells)
    if params.method == "mean":
        inlier = deviation <= params.outlier_sigma * np.sqrt(variance + spread[cell] ** 2)
    else:
        inlier = np.ones(len(points), bool)
    count = np.bincount(cell[inlier], minlength=cells)
    weight = np.bincount(cell[inlier], 1.0 / variance[inlier], cells)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(cell[inlier], z[inlier] / variance[inlier], cells) / weight
        single = np.maximum(count / weight, spread**2)
        sigma = np.sqrt(single / np.maximum(count / params.correlated_px, 1.0))
    elevation = median if params.method == "median" else mean
    unknown = count < params.min_points
    sigma = np.hypot(sigma.reshape(shape), _attitude_sigma(scene, first, shape, params.cell_m))
    layers: dict[str, NDArray[np.generic]] = {
        "elevation": np.where(unknown, np.nan, elevation).reshape(shape).astype(np.float32),
        "sigma_m": np.where(unknown.reshape(shape), np.nan, sigma).astype(np.float32),
        "count": count.reshape(shape).astype(np.int32),
    }
    grid = ElevationMap(float(first[0]) * params.cell_m, float(first[1]) * params.cell_m, params.cell_m, layers)
    return replace(scene, elevation=grid)


def _grouped_median(group: NDArray[np.int64], value: NDArray[np.float64], groups: int) -> NDArray[np.float64]:
    """Return the median (groups,) of the values of each group to 32 bits of their range, NaN where there is none."""
    # One sort of integers, group above and value below, is several times faster than a lexical sort of floats.
    lowest = float(value.min())
    step = max(float(value.max()) - lowest, 1e-12) / (2**VALUE_BITS - 1)
    key = (group << VALUE_BITS) | np.rint((value - lowest) / step).astype(np.int64)
    key.sort()
    ordered = lowest + (key & (2**VALUE_BITS - 1)) * step
    count = np.bincount(group, minlength=groups)
    start = np.cumsum(count) - count
    result = np.full(groups, np.nan)
    some = count > 0
    low = ordered[(start + (count - 1) // 2)[some]]
    high = ordered[(start + count // 2)[some]]
    result[some] = 0.5 * (low + high)
    return result


def _attitude_sigma(scene: Scene, first: NDArray[np.float64], shape: tuple[int, int], cell_m: float) -> np.ndarray:
    """Return the elevation sigma (H, W) that the uncertainty of roll and pitch causes, m."""
    if scene.attitude is None or scene.attitude.sigma_rad == 0.0:
        return np.zeros(shape)
    x = (first[0] + np.arange(shape[1]) + 0.5) * cell_m
    y = (first[1] + np.arange(shape[0]) + 0.5) * cell_m
    return scene.attitude.sigma_rad * np.hypot(x[None, :], y[:, None])


OPERATOR = Operator(
    name="reconstruction.grid_elevation",
    slot="grid",
    params=GridElevationParams,
    function=grid_elevation,
    cost=Cost(fixed_ms=5.0, ns_per_pixel=150.0),
    summary="Averages the points of every cell into an elevation grid with its uncertainty.",
    suits="2.5D terrain; choose cells no smaller than the point spacing at the range that matters.",
)
