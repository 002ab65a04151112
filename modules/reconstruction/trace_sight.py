"""Why a cell is unknown: out of view, hidden by nearer terrain, or seen and not measured."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.frames import level_from_body
from modules.types import Attitude, ElevationMap, Mask, Scene, Sight

Floats = NDArray[np.float32]

MAX_BEARINGS = 4096


class TraceSightParams(OperatorParams):
    """Parameters of `trace_sight`."""

    slack_m: float = Field(
        0.02, ge=0.0, le=1.0, description="A cell is hidden when the line of sight passes this far below terrain, m"
    )


def trace_sight(scene: Scene, params: TraceSightParams) -> Scene:
    """Tell apart what the camera did not see, could not see and saw without a match.

    An unknown cell is taken to be as high as the nearest known one. It is in view when it falls into the left image,
    and hidden when terrain nearer on the same bearing rises above the line from the camera to it.

    Parameters
    ----------
    scene : Scene
        Needs `elevation`, `points` and `calibration`.
    params : TraceSightParams

    Returns
    -------
    Scene
        With the layer `sight`, uint8 `Sight`; filled cells are not measured.

    Raises
    ------
    OperatorError
        Without an elevation grid, points or calibration.

    Notes
    -----
    The horizon is swept on a polar grid about the camera, of one cell per step, as the elevation angle's running
    maximum, so the time is linear in the number of cells.
    """
    if scene.elevation is None or scene.points is None or scene.calibration is None:
        raise OperatorError("sight lines need an elevation grid, points and a calibration; run the grid first")
    grid = scene.elevation
    z = np.asarray(grid.layers["elevation"], np.float32)
    known = np.isfinite(z)
    filled = np.asarray(grid.layers["filled"], bool) if "filled" in grid.layers else np.zeros(known.shape, bool)
    measured = known & ~filled
    guess = _nearest_height(z, known)
    x, y = _centres(grid)
    camera = scene.points.shared.camera_m
    sight = np.full(z.shape, Sight.OUT_OF_VIEW, np.uint8)
    in_view = _in_view(scene, x, y, guess)
    hidden = _hidden(np.where(known, z, -np.inf).astype(np.float32), guess, grid, camera, params.slack_m)
    sight[in_view] = Sight.UNMATCHED
    sight[in_view & hidden] = Sight.OCCLUDED
    sight[measured] = Sight.MEASURED
    return replace(scene, elevation=replace(grid, layers={**grid.layers, "sight": sight}))


def _centres(grid: ElevationMap) -> tuple[Floats, Floats]:
    rows, columns = grid.shape
    x = (grid.x0_m + (np.arange(columns) + 0.5) * grid.cell_m).astype(np.float32)
    y = (grid.y0_m + (np.arange(rows) + 0.5) * grid.cell_m).astype(np.float32)
    return np.broadcast_to(x[None, :], grid.shape), np.broadcast_to(y[:, None], grid.shape)


def _nearest_height(z: Floats, known: Mask) -> Floats:
    """Return each cell's height, or that of the nearest known cell."""
    from scipy.ndimage import distance_transform_edt

    if known.all() or not known.any():
        return np.nan_to_num(z)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(z[tuple(nearest)])


def _in_view(scene: Scene, x: Floats, y: Floats, z: Floats) -> Mask:
    """Return which places (H, W) fall into the left image."""
    calibration, points = scene.calibration, scene.points
    if calibration is None or points is None:
        return np.zeros(z.shape, bool)
    attitude = scene.attitude if scene.attitude is not None else Attitude()
    to_level = (level_from_body(attitude) @ scene.mount.rotation).astype(np.float32)
    camera = points.shared.camera_m
    ray = (x - np.float32(camera[0]), y - np.float32(camera[1]), z - np.float32(camera[2]))
    right, down, depth = (sum(ray[i] * to_level[i, axis] for i in range(3)) for axis in range(3))
    ahead = depth > 1e-3
    safe = np.where(ahead, depth, 1.0)
    u = right / safe * np.float32(calibration.focal_px) + np.float32(calibration.cx_px)
    v = down / safe * np.float32(calibration.focal_px) + np.float32(calibration.cy_px)
    inside = (u >= -0.5) & (u < calibration.width_px - 0.5) & (v >= -0.5) & (v < calibration.height_px - 0.5)
    return np.asarray(ahead & inside)


def _hidden(z: Floats, guess: Floats, grid: ElevationMap, camera: tuple[float, float, float], slack_m: float) -> Mask:
    """Return which cells (H, W) lie below the horizon of nearer known terrain; unknown cells of `z` are -inf."""
    x, y = _centres(grid)
    dx, dy = x - np.float32(camera[0]), y - np.float32(camera[1])
    distance = np.hypot(dx, dy)
    steps = int(distance.max() / grid.cell_m) + 2
    bearings = min(MAX_BEARINGS, max(8, math.ceil(2.0 * math.pi * steps)))
    angle = (np.arange(bearings, dtype=np.float32) + 0.5) * np.float32(2.0 * math.pi / bearings) - np.float32(math.pi)
    reach = (np.arange(steps, dtype=np.float32) + 0.5) * np.float32(grid.cell_m)
    column = (np.cos(angle)[:, None] * reach + np.float32(camera[0] - grid.x0_m)) / np.float32(grid.cell_m) - 0.5
    row = (np.sin(angle)[:, None] * reach + np.float32(camera[1] - grid.y0_m)) / np.float32(grid.cell_m) - 0.5
    border = float("-inf")
    polar = cv2.remap(z, column, row, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=border)
    horizon = np.maximum.accumulate((polar - np.float32(camera[2])) / reach, axis=1)
    # Terrain of the cell itself and of the one before it does not hide it.
    before = np.maximum((distance / grid.cell_m).astype(np.int32) - 2, 0)
    turn = ((np.arctan2(dy, dx) + np.float32(math.pi)) * np.float32(bearings / (2.0 * math.pi))).astype(np.int32)
    ahead = horizon[np.clip(turn, 0, bearings - 1), np.minimum(before, steps - 1)]
    line = (guess - np.float32(camera[2])) / np.maximum(distance, np.float32(1e-3))
    return np.asarray(line < ahead - np.float32(slack_m) / np.maximum(distance, np.float32(1e-3)))


OPERATOR = Operator(
    name="reconstruction.trace_sight",
    slot="sight",
    params=TraceSightParams,
    function=trace_sight,
    cost=Cost(fixed_ms=15.0, ns_per_pixel=20.0),
    summary="Tells of every unknown cell whether it was out of view, hidden by nearer terrain or only not matched.",
    suits="Deciding where to look next, and which holes are shadows that another view fills.",
    needs=("calibration",),
)
