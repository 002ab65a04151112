"""The NumPy kernels against the compiled ones, and a reconstruction where numba cannot be imported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modules.reconstruction import kernels, plain

ROOT = Path(__file__).parents[3]

WITHOUT_NUMBA = """
import importlib.machinery, sys

class NoNumba(importlib.machinery.PathFinder):
    @classmethod
    def find_spec(cls, fullname, path=None, target=None):
        if fullname.partition(".")[0] in ("numba", "llvmlite"):
            return None
        return super().find_spec(fullname, path, target)

sys.meta_path = [NoNumba if finder is importlib.machinery.PathFinder else finder for finder in sys.meta_path]
"""

PROGRAM = """
import numpy as np
from modules.reconstruction.grid_elevation import GridElevationParams, grid_elevation
from modules.reconstruction.remove_radius_outliers import RemoveRadiusOutliersParams, remove_radius_outliers
from modules.reconstruction.remove_statistical_outliers import (
    RemoveStatisticalOutliersParams, remove_statistical_outliers)
from modules.reconstruction.triangulate_disparity import TriangulateDisparityParams, triangulate_disparity
from modules.types import Calibration, Disparity, Scene

rows = np.arange(120, dtype=np.float32)[:, None]
values = np.broadcast_to(4.0 + 0.2 * rows, (120, 160)).astype(np.float32)
values = values + np.random.default_rng(5).normal(0, 0.1, values.shape).astype(np.float32)
values[60, 80] = 40.0  # a lone wrong match
values[:, 100] = np.nan
disparity = Disparity(values, np.where(np.isnan(values), 1, 0).astype(np.uint16))
scene = Scene(disparity, np.zeros((120, 160), np.uint8), Calibration(150.0, 80.0, 20.0, 0.1, 160, 120))
scene = triangulate_disparity(scene, TriangulateDisparityParams())
scene = remove_radius_outliers(scene, RemoveRadiusOutliersParams())
scene = remove_statistical_outliers(scene, RemoveStatisticalOutliersParams())
scene = grid_elevation(scene, GridElevationParams())
import sys, hashlib
total = hashlib.sha256()
for name, layer in sorted(scene.elevation.layers.items()):
    total.update(name.encode() + layer.tobytes())
print("numba" in sys.modules, sorted(scene.rejected.items()), total.hexdigest())
"""


def run(program: str) -> list[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True, env=environment
    )
    return done.stdout.split(maxsplit=1)


def test_points_and_grid_are_the_same_where_numba_cannot_be_imported() -> None:
    with_numba, without = run(PROGRAM), run(WITHOUT_NUMBA + PROGRAM)
    assert (with_numba[0], without[0]) == ("True", "False")
    assert with_numba[1] == without[1]
    assert "isolated" in without[1]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 400), st.integers(1, 40))
def test_cells_have_the_same_sums_and_order(seed: int, points: int, cells: int) -> None:
    rng = np.random.default_rng(seed)
    cell = rng.integers(0, cells, points).astype(np.int32)
    z = np.round(rng.normal(0, 1, points), 1).astype(np.float32)  # with equals among them
    z[rng.random(points) < 0.05] *= np.float32(100.0)
    start, ordered = plain.sort_by_cell(cell, z, cells)
    wanted_start, wanted = kernels.sort_by_cell(cell, z, cells)
    np.testing.assert_array_equal(start, wanted_start)
    np.testing.assert_array_equal(ordered, wanted)
    median = rng.normal(0, 0.3, cells).astype(np.float32)
    limit = rng.uniform(0, 0.5, cells).astype(np.float32)
    variance = rng.uniform(0.01, 1.0, points).astype(np.float32)
    arguments = (cell, z, variance, median, limit, 2.5)
    np.testing.assert_array_equal(plain.sums_of_cells(*arguments), kernels.sums_of_cells(*arguments))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 9), st.floats(0, 1))
def test_neighbours_count_the_same(seed: int, radius: int, nearest: int, gradient: float) -> None:
    rng = np.random.default_rng(seed)
    disparity = rng.normal(10, 1, (rng.integers(1, 12), rng.integers(1, 12))).astype(np.float32)
    disparity[rng.random(disparity.shape) < 0.3] = np.nan
    agreeing = plain.count_agreeing(disparity, radius, gradient, 0.5)
    np.testing.assert_array_equal(agreeing, kernels.count_agreeing(disparity, radius, gradient, 0.5))
    mean = plain.nearest_difference(disparity, radius, nearest)
    np.testing.assert_array_equal(mean, kernels.nearest_difference(disparity, radius, nearest))


def test_strips_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    disparity = np.random.default_rng(1).normal(10, 1, (40, 30)).astype(np.float32)
    whole = plain.nearest_difference(disparity, 2, 8)
    monkeypatch.setattr(plain, "STRIP_BYTES", 4 * 30 * 24 * 7)
    np.testing.assert_array_equal(plain.nearest_difference(disparity, 2, 8), whole)
