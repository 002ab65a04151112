"""The main job on a rendered terrain whose elevation is known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from expert import ExpertSystem, Result, StereoPair
from modules.simulation.terrain import RenderedPair, TerrainParams, render_terrain

NEAR_M = 6.0
CLEARLY_SEEN = 0.5  # part of a cell that the camera must see for its truth to be a fair one


@pytest.fixture(scope="module")
def rendered() -> RenderedPair:
    return render_terrain(TerrainParams(seed=0, roll_deg=5.0, pitch_deg=-8.0))


@pytest.fixture(scope="module")
def result(rendered: RenderedPair) -> Result:
    return ExpertSystem().reconstruct(
        StereoPair(
            rendered.left,
            rendered.right,
            calibration=rendered.calibration,
            attitude=rendered.attitude,
            mount=rendered.mount,
        )
    )


def near_errors(rendered: RenderedPair, result: Result) -> np.ndarray:
    """Return estimated minus true elevation in m over the cells within `NEAR_M` of the body."""
    found = result.elevation
    assert found is not None
    height = found.layers["elevation"]
    truth = rendered.true_elevation(found.x0_m, found.y0_m, found.cell_m, height.shape)
    rows, columns = np.indices(height.shape)
    x = found.x0_m + (columns + 0.5) * found.cell_m
    y = found.y0_m + (rows + 0.5) * found.cell_m
    fair = (np.hypot(x, y) <= NEAR_M) & (truth.layers["visible_fraction"] >= CLEARLY_SEEN)
    errors = (height - truth.layers["elevation"])[fair]
    known = np.isfinite(errors)
    assert known.mean() > 0.8
    return errors[known]


def test_the_median_elevation_error_within_6_m_is_at_most_4_cm(rendered: RenderedPair, result: Result) -> None:
    assert result.decision.status == "reconstructed"
    assert np.median(np.abs(near_errors(rendered, result))) <= 0.04


def test_the_elevation_is_not_tilted_or_raised(rendered: RenderedPair, result: Result) -> None:
    # A wrong sign of roll or pitch would shift the ground by half a metre at 5 m.
    assert abs(np.median(near_errors(rendered, result))) <= 0.02


def test_the_cells_are_5_cm_for_the_default_rig(result: Result) -> None:
    assert result.elevation is not None
    assert result.elevation.cell_m == pytest.approx(0.05)


def test_no_point_of_the_terrain_is_sky(rendered: RenderedPair, result: Result) -> None:
    assert rendered.sky.any()
    assert result.points is not None
    assert not rendered.sky.ravel()[result.points.pixel].any()
