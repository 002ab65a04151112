"""One elevation map of several views, in tiles."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from modules.operator import OperatorError
from modules.reconstruction.grid_elevation import GridElevationParams, grid_elevation
from modules.types import ElevationMap, PointCloud, Pose, Scene

Key = tuple[int, int]
Tile = dict[str, NDArray[np.float32]]

TILE_CELLS = 256
CHI_SQUARE_SIGMAS = 3.0  # views disagree when their scatter exceeds its expectation by this many standard deviations
LEAST_STEP_M = 0.05  # and differ by this much: below it the roughness within a cell explains it
SUMS = ("weight", "weighted", "squares", "views", "count", "shared")
EXTREMES = {"min_m": np.inf, "max_m": -np.inf, "lowest": np.inf, "highest": -np.inf}
LATEST = ("latest", "latest_variance", "latest_s")


class TileStore(Protocol):
    """Where tiles go that do not fit in memory."""

    def save(self, key: Key, tile: Tile) -> None:
        """Keep a tile."""

    def load(self, key: Key) -> Tile | None:
        """Return a tile that was kept, or None."""

    def keys(self) -> list[Key]:
        """Return the keys of all tiles that were kept."""


@dataclass
class FusedMap:
    """An elevation map that grows view by view.

    Cell (0, 0) of tile (0, 0) has its corner at the origin of the map. Each view is gridded by itself; its cells then
    enter with the inverse of their whole variance, pose included, for the pose errors of two views are independent.

    Attributes
    ----------
    cell_m : float
    max_tiles : int
        Tiles of 256 x 256 cells held in memory, 3.4 MB each; older ones go to the store.
    store : TileStore or None
        Without one all tiles stay in memory, and a map that needs more than `max_tiles` is refused.
    """

    cell_m: float = 0.05
    max_tiles: int = 64
    store: TileStore | None = None
    views: int = 0
    last_s: float = -math.inf
    _tiles: OrderedDict[Key, Tile] = field(default_factory=OrderedDict)

    def add(self, scene: Scene, pose: Pose, time_s: float, params: GridElevationParams | None = None) -> None:
        """Add the points of one view.

        Parameters
        ----------
        scene : Scene
            With `points` in the level frame of the pose: its attitude applied, its translation not.
        pose : Pose
        time_s : float
            Not before the view added last.
        params : GridElevationParams, optional
            For the grid of the view; the cell is that of the map.

        Raises
        ------
        OperatorError
            Without points, when the time runs backwards, or when the map needs more tiles than allowed.
        """
        if time_s < self.last_s:
            raise OperatorError(
                f"the view at {time_s:g} s comes after one at {self.last_s:g} s; sort the views by time"
            )
        if scene.points is None or len(scene.points) == 0:
            raise OperatorError("the view has no points; reconstruct it with a calibration first")
        chosen = (params or GridElevationParams()).model_copy(update={"cell_m": self.cell_m})
        moved = replace(scene, points=_moved(scene.points, pose))
        grid = grid_elevation(moved, chosen).elevation
        if grid is None:
            raise OperatorError("the view could not be gridded")
        for key, tile, where, part in self._touched(grid):
            layers = {name: np.asarray(layer)[part] for name, layer in grid.layers.items()}
            _enter({name: values[where] for name, values in tile.items()}, layers, pose.sigma_m, time_s)
            self._tiles[key] = tile
        self.views, self.last_s = self.views + 1, time_s

    def _touched(self, grid: ElevationMap) -> Iterator[tuple[Key, Tile, tuple[slice, slice], tuple[slice, slice]]]:
        """Yield each tile under the grid, the cells of it, and the cells of the grid."""
        row0, column0 = round(grid.y0_m / self.cell_m), round(grid.x0_m / self.cell_m)
        rows, columns = grid.shape
        for i in range(row0 // TILE_CELLS, (row0 + rows - 1) // TILE_CELLS + 1):
            for j in range(column0 // TILE_CELLS, (column0 + columns - 1) // TILE_CELLS + 1):
                top, left = max(row0, i * TILE_CELLS), max(column0, j * TILE_CELLS)
                bottom, right = min(row0 + rows, (i + 1) * TILE_CELLS), min(column0 + columns, (j + 1) * TILE_CELLS)
                where = (
                    slice(top - i * TILE_CELLS, bottom - i * TILE_CELLS),
                    slice(left - j * TILE_CELLS, right - j * TILE_CELLS),
                )
                part = (slice(top - row0, bottom - row0), slice(left - column0, right - column0))
                yield (i, j), self._tile((i, j)), where, part

    def _tile(self, key: Key) -> Tile:
        if key in self._tiles:
            self._tiles.move_to_end(key)
            return self._tiles[key]
        kept = self.store.load(key) if self.store is not None else None
        tile = kept if kept is not None else _empty()
        self._tiles[key] = tile
        if len(self._tiles) > self.max_tiles:
            if self.store is None:
                raise OperatorError(
                    f"the map needs more than {self.max_tiles} tiles of {TILE_CELLS * self.cell_m:g} m; "
                    "use larger cells, allow more tiles or give a folder for them"
                )
            old, content = self._tiles.popitem(last=False)
            self.store.save(old, content)
        return tile

    def elevation(self, max_cells: int = 25_000_000) -> ElevationMap:
        """Return the fused map.

        Returns
        -------
        ElevationMap
            Layers `elevation`, `sigma_m`, `variance_m2`, `min_m`, `max_m`, `median_m` (of the views' mean), `age_s`,
            `count`, `views` and `moving`, true where views disagree beyond their uncertainty; such cells have the
            height of the latest view.

        Raises
        ------
        OperatorError
            Before the first view, or when the map has more than `max_cells` cells.
        """
        keys = sorted({*self._tiles, *(self.store.keys() if self.store is not None else [])})
        if not keys:
            raise OperatorError("no view was added, so there is no map")
        rows, columns = [key[0] for key in keys], [key[1] for key in keys]
        shape = ((max(rows) - min(rows) + 1) * TILE_CELLS, (max(columns) - min(columns) + 1) * TILE_CELLS)
        if shape[0] * shape[1] > max_cells:
            raise OperatorError(
                f"the fused map has {shape[1]}x{shape[0]} cells, above {max_cells}; use larger cells or fuse parts"
            )
        layers: dict[str, NDArray[np.generic]] = {}
        for key in keys:
            tile = self._tiles[key] if key in self._tiles else self._stored(key)
            top, left = (key[0] - min(rows)) * TILE_CELLS, (key[1] - min(columns)) * TILE_CELLS
            for name, values in _finished(tile, self.last_s).items():
                if name not in layers:
                    filler = np.nan if values.dtype == np.float32 else 0
                    layers[name] = np.full(shape, filler, values.dtype)
                layers[name][top : top + TILE_CELLS, left : left + TILE_CELLS] = values
        side = TILE_CELLS * self.cell_m
        return _cropped(ElevationMap(min(columns) * side, min(rows) * side, self.cell_m, layers))

    def _stored(self, key: Key) -> Tile:
        tile = self.store.load(key) if self.store is not None else None
        return tile if tile is not None else _empty()


def _moved(points: PointCloud, pose: Pose) -> PointCloud:
    """Return the points in the frame of the map."""
    shift = np.asarray(pose.translation_m)
    pivot, camera = (np.asarray(place) + shift for place in (points.shared.pivot_m, points.shared.camera_m))
    shared = replace(
        points.shared,
        pivot_m=(float(pivot[0]), float(pivot[1]), float(pivot[2])),
        camera_m=(float(camera[0]), float(camera[1]), float(camera[2])),
    )
    return replace(points, xyz_m=points.xyz_m + shift.astype(np.float32), shared=shared)


def _empty() -> Tile:
    shape = (TILE_CELLS, TILE_CELLS)
    tile = {name: np.zeros(shape, np.float32) for name in SUMS}
    tile.update({name: np.full(shape, start, np.float32) for name, start in EXTREMES.items()})
    tile.update({name: np.full(shape, np.nan, np.float32) for name in LATEST})
    return tile


def _enter(cells: Tile, seen: dict[str, NDArray[np.generic]], pose_sigma_m: float, time_s: float) -> None:
    """Add the cells of one view to the sums, in place; `cells` are views of the tile."""
    z = np.asarray(seen["elevation"], np.float32)
    known = np.isfinite(z)
    z = z[known]
    variance = np.asarray(seen["sigma_m"], np.float32)[known] ** 2 + np.float32(pose_sigma_m**2)
    weight = 1.0 / np.maximum(variance, 1e-8)
    # Squares are taken from the first height, so that they keep their digits far above the datum.
    first = np.where(cells["views"][known] > 0, cells["shared"][known], z)
    cells["shared"][known] = first
    cells["weight"][known] += weight
    cells["weighted"][known] += weight * (z - first)
    cells["squares"][known] += weight * (z - first) ** 2
    cells["views"][known] += 1
    cells["count"][known] += np.asarray(seen["count"], np.float32)[known]
    cells["min_m"][known] = np.minimum(cells["min_m"][known], np.asarray(seen["min_m"], np.float32)[known])
    cells["max_m"][known] = np.maximum(cells["max_m"][known], np.asarray(seen["max_m"], np.float32)[known])
    cells["lowest"][known] = np.minimum(cells["lowest"][known], z)
    cells["highest"][known] = np.maximum(cells["highest"][known], z)
    cells["latest"][known], cells["latest_variance"][known], cells["latest_s"][known] = z, variance, time_s


def _finished(tile: Tile, now_s: float) -> dict[str, NDArray[np.generic]]:
    """Return the layers of a tile."""
    views = tile["views"]
    known = views > 0
    weight = np.maximum(tile["weight"], 1e-12)
    offset = tile["weighted"] / weight
    mean = tile["shared"] + offset
    scatter = np.maximum(tile["squares"] - weight * offset**2, 0.0)
    freedom = np.maximum(views - 1.0, 1.0)
    limit = freedom + CHI_SQUARE_SIGMAS * np.sqrt(2.0 * freedom)
    moving = (views > 1) & (scatter > limit) & (tile["highest"] - tile["lowest"] > LEAST_STEP_M)
    # Where the scatter is somewhat larger than predicted the sigma grows with it, as Birge's ratio does.
    variance = np.maximum(scatter / freedom, 1.0) / weight
    elevation = np.where(moving, tile["latest"], mean)
    sigma = np.sqrt(np.where(moving, tile["latest_variance"], variance))
    floats = {
        "elevation": elevation,
        "sigma_m": sigma,
        "variance_m2": scatter / weight,
        "median_m": mean,
        "min_m": np.where(moving, tile["latest"], tile["min_m"]),
        "max_m": np.where(moving, tile["latest"], tile["max_m"]),
        "age_s": now_s - tile["latest_s"],
    }
    layers: dict[str, NDArray[np.generic]] = {
        name: np.where(known, values, np.nan).astype(np.float32) for name, values in floats.items()
    }
    layers["count"], layers["views"] = tile["count"].astype(np.int32), views.astype(np.int32)
    layers["moving"] = moving & known
    return layers


def _cropped(grid: ElevationMap) -> ElevationMap:
    """Cut off the borders without a known cell."""
    rows, columns = np.nonzero(np.isfinite(np.asarray(grid.layers["elevation"], np.float32)))
    part = (slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1))
    layers = {name: np.ascontiguousarray(layer[part]) for name, layer in grid.layers.items()}
    x0, y0 = grid.x0_m + int(columns.min()) * grid.cell_m, grid.y0_m + int(rows.min()) * grid.cell_m
    return replace(grid, x0_m=x0, y0_m=y0, layers=layers)
