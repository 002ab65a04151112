"""Normals, slope, roughness and step of an elevation grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.patches import fit_planes, relief
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
        With layers, float32, NaN where unknown: `normal_x`, `normal_y`, `normal_z` (upward unit normal of the plane),
        `slope_deg` (its tilt), `roughness_m` (root mean square distance in z from it) and `step_m` (highest less lowest
        cell of the patch).

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
    fit = fit_planes(z, radius, grid.cell_m, params.min_fraction)
    normal_z = 1.0 / np.sqrt(fit.a**2 + fit.b**2 + 1.0)
    found = {
        "normal_x": -fit.a * normal_z,
        "normal_y": -fit.b * normal_z,
        "normal_z": normal_z,
        "slope_deg": np.degrees(np.arccos(normal_z)),
        "roughness_m": fit.residual_m,
        "step_m": relief(z, radius),
    }
    layers = dict(grid.layers)
    for name, layer in found.items():
        layers[name] = np.where(fit.enough, layer, np.nan).astype(np.float32)
    return replace(scene, elevation=replace(grid, layers=layers))


OPERATOR = Operator(
    name="reconstruction.compute_slope",
    slot="terrain",
    params=ComputeSlopeParams,
    function=compute_slope,
    cost=Cost(fixed_ms=5.0, ns_per_pixel=20.0),
    summary="Adds normal, slope, roughness and step of the patch about every cell.",
    suits="Traversability of known terrain; cells near the border of the known terrain see only half a patch.",
)
