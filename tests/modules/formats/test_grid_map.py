"""The NPZ of grid_map, read by the arithmetic of grid_map's own sources, gives every cell of this map back."""

import json
import math

import numpy as np
import pytest

from modules import formats as f
from modules.types import ElevationMap, Hazard

ROWS, COLUMNS, CELL = 20, 40, 0.05


def elevation_map():
    i, j = np.indices((ROWS, COLUMNS))
    elevation = (0.02 * j - 0.03 * i + 0.05 * np.sin(i)).astype(np.float32)
    elevation[3:6, 10:14] = np.nan
    known = np.isfinite(elevation)
    sigma = (0.01 + 0.001 * j).astype(np.float32)
    sigma[8, 7] = np.nan  # filled, without an uncertainty
    normal = np.array([0.3, -0.4, math.sqrt(0.75)], np.float32)
    layers = {
        "elevation": elevation,
        "sigma_m": np.where(known, sigma, np.nan).astype(np.float32),
        "slope_deg": np.where(known, 30.0, np.nan).astype(np.float32),
        "roughness_m": np.where(known, 0.01 * i, np.nan).astype(np.float32),
        "step_m": np.where(known, 0.02 * j, np.nan).astype(np.float32),
        "traversability": np.where(known, 0.5, np.nan).astype(np.float32),
        "count": np.where(known, i + 100 * j, 0).astype(np.int32),
        "filled": np.zeros(elevation.shape, bool),
        "hazard": np.where(known, Hazard.STEP, Hazard.UNKNOWN).astype(np.uint8),
    }
    layers |= {f"normal_{axis}": np.full(elevation.shape, n, np.float32) for axis, n in zip("xyz", normal, strict=True)}
    return ElevationMap(0.3, -0.5, CELL, layers)


class GridMap:
    """What `GridMapRosConverter::fromMessage` makes of the message, with `GridMapMath.cpp`'s index and position."""

    def __init__(self, path):
        with np.load(path, allow_pickle=False) as file:
            message = json.loads(str(file["info"]))
            stored = {name: file[name] for name in message["layers"]}
        info = message["info"]
        self.frame = message["header"]["frame_id"]
        self.resolution = info["resolution"]
        length = np.array([info["length_x"], info["length_y"]])
        self.size = np.round(length / self.resolution).astype(int)  # GridMap::setGeometry
        self.length = self.size * self.resolution
        self.position = np.array([info["pose"]["position"][axis] for axis in "xy"])
        self.start = np.array([message["outer_start_index"], message["inner_start_index"]])
        self.basic = message["basic_layers"]
        outer, inner = message["layout"]["dim"]
        assert (outer["label"], inner["label"]) == ("column_index", "row_index")  # Eigen's order, or it is refused
        assert outer["stride"] == inner["size"] * outer["size"]
        assert inner["stride"] == inner["size"]
        self.layers = {}
        for name, values in stored.items():
            assert values.dtype == np.float32
            data = values.ravel(order="K")[message["layout"]["data_offset"] :]  # as it lies in the file
            self.layers[name] = data.reshape(outer["size"], inner["size"]).T  # Eigen::Map, rows and columns
            assert self.layers[name].shape == tuple(self.size)

    def index(self, x, y):
        """`getIndexFromPosition`: from the corner of largest x and y, backwards, and wrapped by the start index."""
        vector = (np.array([x, y]) - 0.5 * self.length - self.position) / self.resolution
        return tuple((-np.trunc(vector).astype(int) + self.start) % self.size)

    def at(self, name, x, y):
        return self.layers[name][self.index(x, y)]

    def valid(self, x, y):
        return all(np.isfinite(self.at(name, x, y)) for name in self.basic)


@pytest.fixture
def both(tmp_path):
    grid = elevation_map()
    f.write_grid_map(tmp_path / "g.npz", grid)
    return grid, GridMap(tmp_path / "g.npz")


def centres(grid):
    for row in range(ROWS):
        for column in range(COLUMNS):
            yield row, column, grid.x0_m + (column + 0.5) * CELL, grid.y0_m + (row + 0.5) * CELL


def test_every_cell_is_found_at_its_centre(both):
    grid, there = both
    assert there.frame == grid.frame
    for row, column, x, y in centres(grid):
        np.testing.assert_equal(there.at("elevation", x, y), grid.layers["elevation"][row, column])
        np.testing.assert_equal(there.at("count", x, y), grid.layers["count"][row, column])


def test_forward_is_a_falling_row_and_left_a_falling_column(both):
    _, there = both
    row, column = there.index(1.0, 0.0)
    assert there.index(1.0 + CELL, 0.0) == (row - 1, column)
    assert there.index(1.0, CELL) == (row, column - 1)


def test_layers_have_the_names_and_units_that_packages_around_grid_map_read(both):
    grid, there = both
    x, y, row, column = grid.x0_m + 20.5 * CELL, grid.y0_m + 9.5 * CELL, 9, 20
    assert there.at("variance", x, y) == pytest.approx(0.03**2)
    assert there.at("slope", x, y) == pytest.approx(math.acos(there.at("normal_vectors_z", x, y)), abs=1e-6)
    assert there.at("normal_vectors_x", x, y) == pytest.approx(0.3)
    assert there.at("normal_vectors_y", x, y) == pytest.approx(-0.4)
    assert there.at("roughness", x, y) == grid.layers["roughness_m"][row, column]
    assert there.at("step_height", x, y) == grid.layers["step_m"][row, column]
    assert there.at("traversability", x, y) == 0.5
    assert not {"slope_deg", "roughness_m", "step_m", "normal_z", "sigma_m"} & set(there.layers)


def test_bounds_are_two_standard_deviations_from_the_elevation(both):
    grid, there = both
    for row, column, x, y in centres(grid):
        height, sigma = grid.layers["elevation"][row, column], grid.layers["sigma_m"][row, column]
        np.testing.assert_allclose(there.at("lower_bound", x, y), height - 2 * sigma, atol=1e-6)
        np.testing.assert_allclose(there.at("upper_bound", x, y), height + 2 * sigma, atol=1e-6)


def test_a_cell_is_valid_where_its_height_is_known_with_an_uncertainty_or_not(both):
    grid, there = both
    for row, column, x, y in centres(grid):
        assert there.valid(x, y) == np.isfinite(grid.layers["elevation"][row, column])
    filled = grid.x0_m + 7.5 * CELL, grid.y0_m + 8.5 * CELL
    assert np.isnan(there.at("upper_bound", *filled))
    assert there.valid(*filled)


def test_what_is_unknown_is_nan(both):
    _, there = both
    hole = 0.3 + 12.5 * CELL, -0.5 + 4.5 * CELL
    for name in ("elevation", "hazard", "filled", "slope", "variance"):
        assert np.isnan(there.at(name, *hole)), name


def test_a_map_without_an_uncertainty_has_no_bounds(tmp_path):
    grid = ElevationMap(0.0, 0.0, CELL, {"elevation": np.zeros((3, 4), np.float32)})
    f.write_grid_map(tmp_path / "g.npz", grid)
    assert set(GridMap(tmp_path / "g.npz").layers) == {"elevation"}
