"""Small holes of an elevation grid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.types import Mask, Scene

SLOPE_OF_UNKNOWN = math.tan(math.radians(20.0))  # terrain may leave the interpolation this fast: 1 sigma, per metre


class FillHolesParams(OperatorParams):
    """Parameters of `fill_holes`."""

    max_width_m: float = Field(0.3, ge=0.0, le=100.0, description="Widest gap that is filled, m")
    max_cells: int = Field(200_000, ge=1, le=10_000_000, description="Most cells that are filled")


def fill_holes(scene: Scene, params: FillHolesParams) -> Scene:
    """Fill the gaps that are narrower than a limit with the harmonic surface through their rim, and flag them.

    Parameters
    ----------
    scene : Scene
        Needs `elevation`.
    params : FillHolesParams

    Returns
    -------
    Scene
        Known cells are unchanged; filled ones are true in the bool layer `filled` and `sigma_m` grows with the distance
        from the rim. A harmonic surface continues a plane exactly inside a closed hole.

    Raises
    ------
    OperatorError
        Without an elevation grid, or when more than `max_cells` cells would be filled.
    """
    if scene.elevation is None:
        raise OperatorError("there is no elevation grid to fill; run reconstruction.grid_elevation first")
    grid = scene.elevation
    elevation = np.asarray(grid.layers["elevation"], np.float32)
    known = np.isfinite(elevation)
    gap, distance = _narrow_gaps(known, params.max_width_m / grid.cell_m)
    count = int(np.count_nonzero(gap))
    if count > params.max_cells:
        raise OperatorError(
            f"{count} cells would be filled and the limit is {params.max_cells}; "
            "use larger cells or a smaller max_width_m"
        )
    layers = dict(grid.layers)
    layers["filled"] = gap
    if count:
        layers["elevation"] = _harmonic(elevation, known, gap)
        if "sigma_m" in layers:
            layers["sigma_m"] = _grown_sigma(
                np.asarray(layers["sigma_m"], np.float32), known, gap, distance * grid.cell_m
            )
    return replace(scene, elevation=replace(grid, layers=layers))


def _narrow_gaps(known: Mask, width_cells: float) -> tuple[Mask, NDArray[np.float64]]:
    """Return the unknown cells that a closing by a disc covers, and the distance of cells from known ones."""
    from scipy.ndimage import distance_transform_edt

    radius = width_cells / 2.0
    if radius <= 0.0 or known.all() or not known.any():
        return np.zeros_like(known), np.zeros(known.shape)
    margin = math.ceil(radius) + 2
    padded = np.pad(known, margin)
    to_known = distance_transform_edt(~padded)
    to_outside = distance_transform_edt(to_known <= radius)
    inner = (slice(margin, -margin), slice(margin, -margin))
    return (to_outside[inner] > radius) & ~known, to_known[inner]


def _harmonic(elevation: NDArray[np.float32], known: Mask, gap: Mask) -> NDArray[np.float32]:
    """Solve the Laplace equation on the gap cells; edges to cells that stay unknown carry no flux."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import spsolve

    count = int(np.count_nonzero(gap))
    number = np.full(gap.shape, -1, np.int64)
    number[gap] = np.arange(count)
    diagonal, right = np.zeros(count), np.zeros(count)
    entries_i, entries_j = [], []
    height, width = gap.shape
    rows, columns = np.nonzero(gap)
    for step_row, step_column in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        r, c = rows + step_row, columns + step_column
        inside = (r >= 0) & (r < height) & (c >= 0) & (c < width)
        me, r, c = np.flatnonzero(inside), r[inside], c[inside]
        fixed, free = known[r, c], gap[r, c]
        diagonal[me[fixed | free]] += 1.0
        right[me[fixed]] += elevation[r[fixed], c[fixed]]
        entries_i.append(me[free])
        entries_j.append(number[r[free], c[free]])
    i, j = np.concatenate(entries_i), np.concatenate(entries_j)
    # A weak pull to the mean keeps the system solvable where a gap touches known cells only at corners.
    pull = 1e-9
    every = np.arange(count)
    matrix = coo_matrix(
        (
            np.concatenate([diagonal + pull, np.full(len(i), -1.0)]),
            (np.concatenate([every, i]), np.concatenate([every, j])),
        )
    ).tocsc()
    mean = float(np.mean(elevation[known], dtype=np.float64))
    result = elevation.copy()
    result[gap] = np.atleast_1d(spsolve(matrix, right + pull * mean, permc_spec="MMD_AT_PLUS_A"))
    return result


def _grown_sigma(
    sigma: NDArray[np.float32], known: Mask, gap: Mask, distance_m: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Give filled cells the sigma of the nearest known cell and a share that grows with its distance."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    spread = sigma[nearest[0], nearest[1]]
    return np.where(gap, np.hypot(spread, SLOPE_OF_UNKNOWN * distance_m), sigma).astype(np.float32)


OPERATOR = Operator(
    name="reconstruction.fill_holes",
    slot="fill",
    params=FillHolesParams,
    function=fill_holes,
    cost=Cost(fixed_ms=20.0, ns_per_pixel=50.0),
    summary="Fills narrow gaps of the elevation grid and flags them.",
    suits="Gaps from sparse far points or small occlusions; keep it narrow, what a rock hides stays unknown.",
)
