"""A triangle mesh of an elevation map, coloured by the points it was made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modules.types import ElevationMap, Mask, PointCloud

GREY = 160  # of a cell without colour


@dataclass(frozen=True)
class Surface:
    """A mesh.

    Attributes
    ----------
    vertices_m : float32 (N, 3)
        Centres of the known cells, frame of the map.
    faces : int32 (M, 3)
        Vertices of each triangle, counter-clockwise from above.
    rgb : uint8 (N, 3)
    cells : int64 (N,)
        Flat index of each vertex's cell.
    """

    vertices_m: NDArray[np.float32]
    faces: NDArray[np.int32]
    rgb: NDArray[np.uint8]
    cells: NDArray[np.int64]


def surface_of(grid: ElevationMap, points: PointCloud | None = None, known: Mask | None = None) -> Surface:
    """Join the centres of known neighbouring cells by triangles.

    Parameters
    ----------
    grid : ElevationMap
    points : PointCloud, optional
        Colours the cells by the mean of its points; grey without.
    known : bool (H, W), optional
        Cells to take; all with an elevation by default.
    """
    z = np.asarray(grid.layers["elevation"], np.float32)
    taken = np.isfinite(z) if known is None else known & np.isfinite(z)
    cells = np.flatnonzero(taken)
    number = np.full(z.shape, -1, np.int32)
    number[taken] = np.arange(len(cells), dtype=np.int32)
    rows, columns = np.divmod(cells, z.shape[1])
    vertices = np.column_stack(
        [
            grid.x0_m + (columns + 0.5) * grid.cell_m,
            grid.y0_m + (rows + 0.5) * grid.cell_m,
            z.ravel()[cells].astype(np.float64),
        ]
    )
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    lower = np.stack([a, b, c], axis=-1).reshape(-1, 3)
    upper = np.stack([a, c, d], axis=-1).reshape(-1, 3)
    corner = np.stack([a, b, d], axis=-1).reshape(-1, 3)  # where only the far corner is unknown
    other = np.stack([b, c, d], axis=-1).reshape(-1, 3)  # where only the near one is
    keep_lower, keep_upper = (lower >= 0).all(axis=1), (upper >= 0).all(axis=1)
    keep_corner = (corner >= 0).all(axis=1) & (c.ravel() < 0)
    keep_other = (other >= 0).all(axis=1) & (a.ravel() < 0)
    faces = np.concatenate([lower[keep_lower], upper[keep_upper], corner[keep_corner], other[keep_other]])
    colours = cell_colours(grid, points).reshape(-1, 3)[cells]
    return Surface(vertices.astype(np.float32), faces.astype(np.int32), colours, cells)


def cell_colours(grid: ElevationMap, points: PointCloud | None) -> NDArray[np.uint8]:
    """Return the mean colour (H, W, 3) of the points of each cell, or that of the nearest cell that has one."""
    from scipy.ndimage import distance_transform_edt

    rows, columns = grid.shape
    result = np.full((rows, columns, 3), GREY, np.uint8)
    if points is None or points.rgb is None or len(points) == 0:
        return result
    column = np.floor((points.xyz_m[:, 0] - grid.x0_m) / grid.cell_m).astype(np.int64)
    row = np.floor((points.xyz_m[:, 1] - grid.y0_m) / grid.cell_m).astype(np.int64)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    cell = row[inside] * columns + column[inside]
    count = np.bincount(cell, minlength=rows * columns)
    some = (count > 0).reshape(rows, columns)
    if not some.any():
        return result
    for channel in range(3):
        total = np.bincount(cell, points.rgb[inside, channel], rows * columns)
        result[..., channel] = np.rint(total / np.maximum(count, 1)).reshape(rows, columns)
    nearest = distance_transform_edt(~some, return_distances=False, return_indices=True)
    return np.asarray(result[tuple(nearest)])
