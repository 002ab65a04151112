"""Where a rover can stand and drive, and what hinders it."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.patches import disc, fit_planes, highest, lowest
from modules.types import ElevationMap, Hazard, Mask, Scene

Floats = NDArray[np.float64]

ONSET = 0.5  # a quantity below this part of its limit costs no goodness
ROUGH_SIGMAS = 3.0  # bumps of this many standard deviations reach the belly
MIN_PATCH = 0.3  # known part of a patch of ground that a plane needs
MAX_PATCH_CELLS = 101
TOP_POINTS = 3  # a highest point of fewer may be a wrong match
BORDER_KNOWN = (0.5, 0.95)  # known part of the ground under the rover: hazard below the first, no cost above the second


class AssessTraversabilityParams(OperatorParams):
    """Parameters of `assess_traversability`: the rover."""

    wheel_radius_m: float = Field(
        0.115, gt=0.0, le=2.0, description="Radius of the wheels, m; higher steps are hazards"
    )
    clearance_m: float = Field(0.25, gt=0.0, le=5.0, description="Height of the belly above the ground, m")
    width_m: float = Field(0.8, gt=0.0, le=10.0, description="Width of the rover, m; it may turn on the spot")
    max_tilt_deg: float = Field(20.0, gt=0.0, le=60.0, description="Largest tilt of the rover, deg")


def assess_traversability(scene: Scene, params: AssessTraversabilityParams) -> Scene:
    """Compare every cell with what the rover can take, and then the ground under the rover standing there.

    - Step: height of the cell above the lowest one within a wheel's diameter, less what the slope explains; the limit
      is the wheel's radius.
    - Roughness: height above the plane of the ground, or three times its scatter; the limit is the clearance.
    - Slope: tilt of the plane of the ground, a patch as wide as the rover without the cells that are steps.
    - Border: unknown ground under the rover.

    Parameters
    ----------
    scene : Scene
        Needs `elevation`.
    params : AssessTraversabilityParams

    Returns
    -------
    Scene
        With layers of the cell itself, `goodness` (float32, 1 below half of every limit, 0 at a limit, NaN unknown) and
        `hazard` (uint8 `Hazard`), and of the rover standing on it, `traversability` (float32: the lowest goodness of
        the ground under the rover) and `limiting_hazard` (uint8 `Hazard`: what lowers it most).

    Raises
    ------
    OperatorError
        Without an elevation grid, or where the cells are too large or too small for the rover.

    References
    ----------
    S. Goldberg, M. Maimone and L. Matthies, "Stereo vision and rover navigation software for planetary exploration",
    IEEE Aerospace Conference 2002 (GESTALT).
    """
    if scene.elevation is None:
        raise OperatorError("there is no elevation grid; run reconstruction.grid_elevation first")
    grid = scene.elevation
    _check_scale(grid.cell_m, params)
    z = np.asarray(grid.layers["elevation"], np.float64)
    known = np.isfinite(z)
    top = _tops(z, grid)
    goods = _goods(z, top, grid.cell_m, params)
    goodness = np.min(list(goods.values()), axis=0)
    hazard = _code(goods, goodness, goodness <= 0.0)
    hazard[~known] = Hazard.UNKNOWN
    rover = disc(0.5 * params.width_m / grid.cell_m)
    under = {code: np.minimum(1.0, lowest(np.where(known, good, np.nan), rover)) for code, good in goods.items()}
    under[Hazard.BORDER] = _border(known, rover)
    traversability = np.min(list(under.values()), axis=0)
    limiting = _code(under, traversability, traversability < 1.0)
    limiting[~known] = Hazard.UNKNOWN
    layers = dict(grid.layers)
    layers["goodness"] = np.where(known, goodness, np.nan).astype(np.float32)
    layers["hazard"] = hazard
    layers["traversability"] = np.where(known, traversability, np.nan).astype(np.float32)
    layers["limiting_hazard"] = limiting
    return replace(scene, elevation=replace(grid, layers=layers))


def _check_scale(cell_m: float, params: AssessTraversabilityParams) -> None:
    if cell_m > 2.0 * params.wheel_radius_m:
        raise OperatorError(
            f"cells of {cell_m:g} m are larger than a wheel of {2 * params.wheel_radius_m:g} m; "
            "steps would be missed: use smaller cells"
        )
    if params.width_m / cell_m > MAX_PATCH_CELLS:
        raise OperatorError(
            f"a rover of {params.width_m:g} m is {params.width_m / cell_m:.0f} cells of {cell_m:g} m wide and "
            f"{MAX_PATCH_CELLS} are possible; use larger cells"
        )


def _tops(z: Floats, grid: ElevationMap) -> Floats:
    """Return the highest point (H, W) of every cell, because a mean over a cell blunts the edge of a rock."""
    if "max_m" not in grid.layers:
        return z
    top = np.asarray(grid.layers["max_m"], np.float64)
    enough = np.asarray(grid.layers["count"]) >= TOP_POINTS
    return np.where(enough & np.isfinite(top), np.maximum(top, z), z)


def _goods(z: Floats, top: Floats, cell_m: float, params: AssessTraversabilityParams) -> dict[Hazard, Floats]:
    """Return the goodness (H, W) of each cell by hazard; 1 where unknown."""
    reach = disc(max(1.5, 2.0 * params.wheel_radius_m / cell_m))
    radius = max(1, round((params.width_m / cell_m - 1.0) / 2.0))
    with np.errstate(invalid="ignore"):
        above = z - lowest(z, reach)
        obstacle = (above > 0.5 * params.wheel_radius_m) | (highest(z, reach) - z > params.wheel_radius_m)
    # What stands out is left out of the ground first, so that a rock does not tilt the plane that it is compared with.
    ground = fit_planes(z, radius, cell_m, MIN_PATCH, used=~obstacle)
    everything = fit_planes(z, radius, cell_m, 0.0)
    a = np.where(ground.enough, ground.a, everything.a)
    b = np.where(ground.enough, ground.b, everything.b)
    height = np.where(ground.enough, ground.height_m, everything.height_m)
    scatter = np.where(ground.enough, ground.residual_m, everything.residual_m)
    known = np.isfinite(z)
    step = _step(z, top, a, b, reach, cell_m, math.tan(math.radians(params.max_tilt_deg)))
    rough = np.maximum(np.abs(np.where(known, z - height, 0.0)), ROUGH_SIGMAS * scatter)
    tilt = np.degrees(np.arctan(np.hypot(a, b)))
    return {
        Hazard.STEP: _good(step, params.wheel_radius_m, known),
        Hazard.ROUGHNESS: _good(rough, params.clearance_m, known),
        Hazard.SLOPE: _good(tilt, params.max_tilt_deg, known),
    }


def _step(
    z: Floats, top: Floats, a: Floats, b: Floats, kernel: NDArray[np.uint8], cell_m: float, steepest: float
) -> Floats:
    """Return the height (H, W) of each top above the neighbours under the kernel, less that of the slope a, b."""
    scale = np.minimum(1.0, steepest / np.maximum(np.hypot(a, b), 1e-9)) * cell_m
    a, b = a * scale, b * scale
    filled = np.where(np.isfinite(z), z, np.inf)
    reach = kernel.shape[0] // 2
    padded = cv2.copyMakeBorder(filled, reach, reach, reach, reach, cv2.BORDER_CONSTANT, value=np.inf)
    below = np.full(z.shape, np.inf)
    for i, j in np.argwhere(kernel):
        neighbour = padded[i : i + z.shape[0], j : j + z.shape[1]]
        np.minimum(below, neighbour - a * (j - reach) - b * (i - reach), out=below)
    return np.where(np.isfinite(z), top - below, 0.0)


def _good(value: Floats, limit: float, known: Mask) -> Floats:
    """Return 1 below `ONSET` of the limit, 0 from the limit on; 1 where unknown."""
    return np.where(known, np.clip((limit - value) / ((1.0 - ONSET) * limit), 0.0, 1.0), 1.0)


def _border(known: Mask, rover: NDArray[np.uint8]) -> Floats:
    """Return the goodness (H, W) by the known part of the ground under the rover; beyond the grid nothing is known."""
    kernel = rover.astype(np.float64) / rover.sum()
    part = cv2.filter2D(known.astype(np.float64), cv2.CV_64F, kernel, borderType=cv2.BORDER_CONSTANT)
    low, high = BORDER_KNOWN
    return np.clip((part - low) / (high - low), 0.0, 1.0)


def _code(goods: dict[Hazard, Floats], lowest_good: Floats, where: Mask) -> NDArray[np.uint8]:
    """Return which hazard has the lowest goodness where `where`, else `Hazard.NONE`."""
    code = np.zeros(lowest_good.shape, np.uint8)
    for hazard, good in reversed(goods.items()):  # the first of equals wins
        code[where & (good <= lowest_good)] = hazard
    return code


OPERATOR = Operator(
    name="reconstruction.assess_traversability",
    slot="traversability",
    params=AssessTraversabilityParams,
    function=assess_traversability,
    cost=Cost(fixed_ms=15.0, ns_per_pixel=40.0),
    summary="Compares step, roughness and slope of every cell and under the whole rover with its limits.",
    suits="Planning the next metres of a wheeled rover; cells must be smaller than a wheel.",
)
