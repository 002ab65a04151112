"""Compare the hazards of an elevation map with the rocks and slopes of rendered terrain."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, find_objects, label, maximum
from scipy.spatial import cKDTree

from modules.simulation.heightfield import NEAR_CELL_M, NEAR_X_M, NEAR_Y_M
from modules.simulation.terrain import RenderedPair
from modules.types import ElevationMap, Hazard

WITHIN_M = 5.0
TALL_M = 0.15  # rocks from here on must be found
HAZARDOUS_M = 0.125  # steps from here on are hazards: the radius of the default rover's wheels
TOUCH_M = 0.10  # a hazard cell this near to a rock's outline is about it
GROUND_REACH_M = 0.15  # the ground that a rock's height is measured from
GROUND_M = 1.01  # window of the opening that removes rocks, the largest is 1 m wide
SEEN = 0.15  # part of a rock that the camera must see
SLOPE_PATCH_M = 0.6
MAX_TILT_DEG = 20.0  # of the default rover


@dataclass(frozen=True)
class Hazards:
    """Counts that add over seeds."""

    rocks: int = 0
    found: int = 0
    cells: int = 0
    explained_cells: int = 0

    def __add__(self, other: Hazards) -> Hazards:
        return Hazards(
            self.rocks + other.rocks,
            self.found + other.found,
            self.cells + other.cells,
            self.explained_cells + other.explained_cells,
        )

    @property
    def recall(self) -> float:
        """Return the part of the tall rocks that were found."""
        return self.found / self.rocks if self.rocks else 1.0

    @property
    def explained(self) -> float:
        """Return the part of the hazard cells that rocks or slopes explain."""
        return self.explained_cells / self.cells if self.cells else 1.0


def _crop(made: RenderedPair) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float64]]:
    """Return heights of the near terrain and the x, y of its columns and rows, heading frame."""
    x = NEAR_X_M[0] + NEAR_CELL_M * np.arange(made.heightfield.near.height_m.shape[1])
    y = NEAR_Y_M[0] + NEAR_CELL_M * np.arange(made.heightfield.near.height_m.shape[0])
    columns, rows = np.abs(x) <= WITHIN_M + 1.5, np.abs(y) <= WITHIN_M + 1.5
    return made.heightfield.near.height_m[np.ix_(rows, columns)], x[columns], y[rows]


def score_hazards(made: RenderedPair, grid: ElevationMap) -> Hazards:
    """Count rocks that some hazard cell touches, and hazard cells that rocks or slopes explain.

    A rock is a connected piece of the surface that the renderer made of rock. It is tall by its height above the mean
    ground within 15 cm, and hazardous by the step from the lowest ground within 10 cm. A hazard cell is explained
    within 10 cm of a rock with a step of more than 12.5 cm, or where the ground without rocks, over 60 cm, is steeper
    than 20 degrees.
    """
    height, x, y = _crop(made)
    rock = made.heightfield.near.rock
    full_x = NEAR_X_M[0] + NEAR_CELL_M * np.arange(rock.shape[1])
    full_y = NEAR_Y_M[0] + NEAR_CELL_M * np.arange(rock.shape[0])
    stone = rock[np.ix_((full_y >= y[0]) & (full_y <= y[-1]), (full_x >= x[0]) & (full_x <= x[-1]))] > 0.3
    labels, count = label(stone)
    ring = np.ones((2 * round(TOUCH_M / NEAR_CELL_M) + 1,) * 2, np.uint8)
    low = cv2.erode(np.where(stone, np.inf, height).astype(np.float32), ring)  # the lowest ground near by
    number = np.arange(1, count + 1)
    step = maximum(np.where(np.isfinite(low), height - low, 0.0), labels, number) if count else np.zeros(0)
    rise = maximum(height - _mean_ground(height, stone), labels, number) if count else np.zeros(0)
    cells = _hazard_cells(made, grid)
    near = cells[np.hypot(cells[:, 0], cells[:, 1]) <= WITHIN_M]
    rocks, found = _found(made, labels, rise, cells, x, y)
    distance = distance_transform_edt(~np.isin(labels, number[step >= HAZARDOUS_M])) * NEAR_CELL_M
    steep = _steep(height)
    row = np.clip(np.round((near[:, 1] - y[0]) / NEAR_CELL_M).astype(int), 0, len(y) - 1)
    column = np.clip(np.round((near[:, 0] - x[0]) / NEAR_CELL_M).astype(int), 0, len(x) - 1)
    explained = (distance[row, column] <= TOUCH_M) | steep[row, column]
    return Hazards(rocks, found, len(near), int(np.count_nonzero(explained)))


def _mean_ground(height: NDArray[np.float32], stone: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the mean height of what is no rock about each place; the height itself where all is rock."""
    window = (2 * round(GROUND_REACH_M / NEAR_CELL_M) + 1,) * 2
    part = cv2.blur((~stone).astype(np.float32), window)
    total = cv2.blur(np.where(stone, 0.0, height).astype(np.float32), window)
    return np.where(part > 0.02, total / np.maximum(part, 1e-6), height).astype(np.float32)


def _hazard_cells(made: RenderedPair, grid: ElevationMap) -> NDArray[np.float64]:
    """Return the centres (N, 2) of the hazard cells in the heading frame."""
    i, j = np.nonzero(np.isin(grid.layers["hazard"], (Hazard.STEP, Hazard.ROUGHNESS, Hazard.SLOPE)))
    x, y = grid.x0_m + (j + 0.5) * grid.cell_m, grid.y0_m + (i + 0.5) * grid.cell_m
    c, s = np.cos(made.attitude.yaw_rad), np.sin(made.attitude.yaw_rad)
    return np.column_stack([c * x + s * y, c * y - s * x])


def _found(
    made: RenderedPair,
    labels: NDArray[np.int32],
    rise: NDArray[np.float64],
    cells: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> tuple[int, int]:
    """Return how many tall rocks are seen, and how many of them a hazard cell touches."""
    tree = cKDTree(cells) if len(cells) else None
    rocks = found = 0
    for index, where in enumerate(find_objects(labels)):
        if where is None or rise[index] < TALL_M:
            continue
        i, j = np.nonzero(labels[where] == index + 1)
        px, py = x[j + where[1].start], y[i + where[0].start]
        if np.hypot(px.mean(), py.mean()) > WITHIN_M or _seen(made, px, py) < SEEN:
            continue
        rocks += 1
        if tree is not None and float(tree.query(np.column_stack([px, py]))[0].min()) <= TOUCH_M:
            found += 1
    return rocks, found


def _seen(made: RenderedPair, x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return the part of the points of the heading frame whose cell the left camera sees."""
    c, s = np.cos(made.attitude.yaw_rad), np.sin(made.attitude.yaw_rad)
    level_x, level_y = c * x - s * y, s * x + c * y
    truth = made.elevation
    i = np.floor((level_y - truth.y0_m) / truth.cell_m).astype(int)
    j = np.floor((level_x - truth.x0_m) / truth.cell_m).astype(int)
    inside = (i >= 0) & (i < truth.shape[0]) & (j >= 0) & (j < truth.shape[1])
    part = np.zeros(len(x))
    part[inside] = truth.layers["visible_fraction"][i[inside], j[inside]]
    return float(part.mean())


def _steep(height: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return where the ground without rocks is too steep."""
    cells = round(GROUND_M / NEAR_CELL_M)
    small = cv2.resize(height, None, fx=0.2, fy=0.2, interpolation=cv2.INTER_AREA)
    opened = cv2.morphologyEx(small, cv2.MORPH_OPEN, np.ones((cells // 5, cells // 5), np.uint8))
    patch = round(SLOPE_PATCH_M / NEAR_CELL_M / 5)
    smooth = cv2.blur(opened, (patch, patch))
    gy, gx = np.gradient(smooth, 5 * NEAR_CELL_M)
    slope = np.degrees(np.arctan(np.hypot(gx, gy))).astype(np.float32)
    return cv2.resize(slope, height.shape[::-1], interpolation=cv2.INTER_LINEAR) > MAX_TILT_DEG
