"""Elevation grid from points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.covariance import own_height_variance, shared_height_variance
from modules.reconstruction.plain import load_kernels
from modules.types import ElevationMap, FloatImage, PointCloud, Scene

QUARTILES_TO_SIGMA = 0.7413  # standard deviation of a Gaussian over the distance of its quartiles
LEAST_SIGMA_M = 1e-4  # weights stay finite where a matcher states no noise


class GridElevationParams(OperatorParams):
    """Parameters of `grid_elevation`."""

    cell_m: float = Field(0.05, ge=0.001, le=100.0, description="Edge of a cell, m")
    method: Literal["mean", "median"] = Field(
        "mean", description="Elevation is the inverse-variance mean without outliers, or the median; of the z in a cell"
    )
    outlier_sigma: float = Field(
        3.0, ge=1.0, le=100.0, description="The mean leaves out points farther from the cell's median, in sigma"
    )
    correlated_px: float = Field(
        10.0, ge=1.0, le=1000.0, description="Neighbouring pixels that share one disparity error, for the sigma only"
    )
    min_points: int = Field(1, ge=1, le=1000, description="Fewest points in a known cell")
    max_cells: int = Field(4_000_000, ge=100, le=100_000_000, description="Most cells of the grid")


@dataclass(frozen=True)
class _Frame:
    """Where the grid lies, and the cell of every point (N,)."""

    x0_m: float
    y0_m: float
    shape: tuple[int, int]
    cell: NDArray[np.int32]

    @property
    def cells(self) -> int:
        return self.shape[0] * self.shape[1]


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
        With `elevation`: layers `elevation`, `median_m`, `min_m`, `max_m` (m), `variance_m2` (of the points' heights),
        `sigma_m` (of the elevation: disparity noise by the effective number of points, or their spread if larger, and
        what all points share, as the error of the attitude), `age_s` (0), float32 and NaN where unknown; `count` int32
        (outliers not counted).

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
    frame = _frame(points, params)
    z = np.ascontiguousarray(points.xyz_m[:, 2])
    layers = _statistics(frame, z, own_height_variance(points, LEAST_SIGMA_M), params)
    shared = _shared_variance(frame, points, params.cell_m, layers["elevation"])
    layers["sigma_m"] = np.sqrt(layers["sigma_m"] ** 2 + shared).astype(np.float32)
    layers["age_s"] = np.where(np.isfinite(layers["elevation"]), np.float32(0.0), np.float32(np.nan))
    named: dict[str, NDArray[np.generic]] = {**layers}
    named["count"] = np.nan_to_num(layers["count"]).astype(np.int32)
    return replace(scene, elevation=ElevationMap(frame.x0_m, frame.y0_m, params.cell_m, named))


def _frame(points: PointCloud, params: GridElevationParams) -> _Frame:
    xy = [np.ascontiguousarray(points.xyz_m[:, axis]) for axis in range(2)]
    first = [np.floor(float(values.min()) / params.cell_m) for values in xy]
    last = [np.floor(float(values.max()) / params.cell_m) for values in xy]
    columns, rows = (float(high - low + 1.0) for low, high in zip(first, last, strict=True))
    if columns * rows > params.max_cells:
        larger = params.cell_m * float(np.sqrt(columns * rows / params.max_cells))
        raise OperatorError(
            f"a grid of {columns:.0f}x{rows:.0f} cells of {params.cell_m:g} m exceeds {params.max_cells} cells; "
            f"use cells of {larger * 1.01:.2g} m or more, or a smaller range"
        )
    shape = (int(rows), int(columns))
    x0, y0 = float(first[0]) * params.cell_m, float(first[1]) * params.cell_m
    column, row = (
        np.clip((values - np.float32(origin)) * np.float32(1.0 / params.cell_m), 0, size - 1).astype(np.int32)
        for values, origin, size in zip(xy, (x0, y0), (shape[1], shape[0]), strict=True)
    )
    return _Frame(x0, y0, shape, row * np.int32(shape[1]) + column)


def _statistics(
    frame: _Frame, z: NDArray[np.float32], variance: NDArray[np.float32], params: GridElevationParams
) -> dict[str, FloatImage]:
    """Return the layers (H, W) that follow from the points of each cell alone; NaN where it has too few."""
    kernels = load_kernels()

    start, ordered = kernels.sort_by_cell(frame.cell, z, frame.cells)
    first, number = start[:-1], np.diff(start)
    last = np.maximum(number - 1, 0)

    def at(place: NDArray[np.integer]) -> NDArray[np.float32]:
        return np.asarray(ordered[np.minimum(first + place, len(ordered) - 1)])

    median = 0.5 * (at(last // 2) + at((last + 1) // 2))
    spread = QUARTILES_TO_SIGMA * (at(3 * last // 4) - at(last // 4))
    limit = spread**2 if params.method == "mean" else np.full(frame.cells, np.inf, np.float32)
    sums = kernels.sums_of_cells(frame.cell, z, variance, median, limit.astype(np.float32), params.outlier_sigma)
    count, weight = sums[:, 0], sums[:, 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = median + sums[:, 2] / weight
        of_points = np.maximum(sums[:, 4] / count - (sums[:, 3] / count) ** 2, 0.0)
        single = np.maximum(count / weight, spread**2)
        sigma = np.sqrt(single / np.maximum(count / params.correlated_px, 1.0))
    unknown = count < params.min_points
    layers = {
        "elevation": median if params.method == "median" else mean,
        "sigma_m": sigma,
        "variance_m2": of_points,
        "median_m": median,
        "min_m": at(np.zeros_like(last)),
        "max_m": at(last),
        "count": count,
    }
    return {name: np.where(unknown, np.nan, v).reshape(frame.shape).astype(np.float32) for name, v in layers.items()}


def _shared_variance(frame: _Frame, points: PointCloud, cell_m: float, elevation: FloatImage) -> NDArray[np.floating]:
    """Return the variance (H, W), m^2, of the elevation that all points share."""
    x = frame.x0_m + (np.arange(frame.shape[1]) + 0.5) * cell_m
    y = frame.y0_m + (np.arange(frame.shape[0]) + 0.5) * cell_m
    return shared_height_variance((x[None, :], y[:, None], elevation.astype(np.float64)), points.shared)


OPERATOR = Operator(
    name="reconstruction.grid_elevation",
    slot="grid",
    params=GridElevationParams,
    function=grid_elevation,
    cost=Cost(fixed_ms=3.0, ns_per_pixel=40.0),
    summary="Averages the points of every cell into an elevation grid with its uncertainty.",
    suits="2.5D terrain; choose cells no smaller than the point spacing at the range that matters.",
)
