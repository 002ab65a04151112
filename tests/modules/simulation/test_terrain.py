"""The renderer's truth is exact: disparity, occlusion, elevation."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from modules.simulation import RenderedPair, TerrainParams, render_terrain

SMALL = {"width_px": 320, "height_px": 240, "focal_px": 250.0}
FLAT = {"roughness_m": 0.0, "relief_m": 0.0, "hills_m": 0.0, "rock_abundance": 0.0}


@pytest.fixture(scope="module")
def pair() -> RenderedPair:
    return render_terrain(TerrainParams(seed=3, **SMALL))


def level_points(pair: RenderedPair) -> np.ndarray:
    """Triangulate all terrain pixels; written out here, apart from the renderer's own geometry."""
    c = pair.calibration
    v, u = np.nonzero(~pair.sky)
    z = c.focal_px * c.baseline_m / pair.disparity_px[v, u].astype(float)
    optical = np.stack([(u - c.cx_px) / c.focal_px * z, (v - c.cy_px) / c.focal_px * z, z])
    body = pair.mount.rotation @ optical + np.array(pair.mount.translation_m)[:, None]
    r, p, y = pair.attitude.roll_rad, pair.attitude.pitch_rad, pair.attitude.yaw_rad
    rx = np.array([[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]])
    ry = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    rz = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    return (rz @ ry @ rx @ body).T


def warp_error_dn(pair: RenderedPair) -> np.ndarray:
    rows, columns = pair.disparity_px.shape
    v, u = np.mgrid[:rows, :columns].astype(np.float32)
    warped = cv2.remap(pair.right, u - np.nan_to_num(pair.disparity_px), v, cv2.INTER_LINEAR)
    return np.abs(warped.astype(float) - pair.left).mean(axis=2)


def test_the_right_image_shows_the_same_colour_at_the_disparity(pair: RenderedPair) -> None:
    error = warp_error_dn(pair)
    # Interpolation between aliasing-free pixels and rounding to whole levels leave a few DN.
    assert np.median(error[pair.nonocc]) <= 2.0
    assert np.percentile(error[pair.nonocc], 95) <= 10.0
    wrong = np.abs(np.roll(pair.left, 3, axis=1).astype(float) - pair.left).mean(axis=2)
    assert np.median(wrong[pair.nonocc]) > 2 * np.median(error[pair.nonocc])


@pytest.mark.parametrize(("roll", "pitch", "yaw"), [(8.0, -5.0, 0.0), (-6.0, 10.0, 40.0), (3.0, 4.0, -150.0)])
def test_triangulated_points_lie_on_the_terrain(roll: float, pitch: float, yaw: float) -> None:
    params = TerrainParams(
        seed=5, width_px=160, height_px=120, focal_px=125, supersample=1, roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw
    )
    pair = render_terrain(params)
    points = level_points(pair)
    off = np.abs(points[:, 2] - pair.height_m(points[:, 0], points[:, 1]))
    near = np.hypot(points[:, 0], points[:, 1]) < 15
    assert near.sum() > 5000
    # The disparity is stored as float32: far less than a millimetre here.
    assert np.median(off[near]) < 1e-4
    assert np.percentile(off[near], 99) < 0.01

    cells = pair.elevation
    layer = cells.layers["elevation"]
    column = np.floor((points[:, 0] - cells.x0_m) / cells.cell_m).astype(int)
    row = np.floor((points[:, 1] - cells.y0_m) / cells.cell_m).astype(int)
    inside = (column >= 0) & (row >= 0) & (column < layer.shape[1]) & (row < layer.shape[0])
    difference = np.abs(points[inside, 2] - layer[row[inside], column[inside]])
    assert inside.sum() > 4000
    assert np.isfinite(difference).mean() > 0.97
    assert np.nanmedian(difference) < 0.01


@pytest.mark.parametrize("pitch", [-4.0, 7.0])
def test_flat_ground_under_pitch_has_the_closed_form_disparity(pitch: float) -> None:
    pair = render_terrain(TerrainParams(**SMALL, **FLAT, supersample=1, pitch_deg=pitch))
    c = pair.calibration
    down = np.radians(15.0 + pitch)
    above = 1.0 * np.cos(np.radians(pitch))  # the camera stands on the body's z axis
    tangent = (np.arange(c.height_px) - c.cy_px) / c.focal_px
    # A ray of unit depth sinks by sin(down) + tangent cos(down).
    sink = np.sin(down) + tangent * np.cos(down)
    expected = c.focal_px * c.baseline_m * sink / above
    rows = expected > 0.5
    assert np.allclose(pair.disparity_px[rows], expected[rows, None], atol=1e-3)
    assert np.all(pair.sky[sink <= 0])
    assert np.abs(pair.elevation.layers["elevation"][np.isfinite(pair.elevation.layers["elevation"])]).max() < 1e-6


def test_flat_ground_is_hidden_only_outside_the_right_image() -> None:
    pair = render_terrain(TerrainParams(**SMALL, **FLAT, supersample=1))
    columns = np.arange(pair.calibration.width_px)[None, :]
    outside = columns - pair.disparity_px < 0
    assert np.array_equal(pair.occluded, outside)


def test_the_masks_part_the_image(pair: RenderedPair) -> None:
    parts = pair.sky.astype(int) + pair.occluded + pair.nonocc
    assert np.all(parts == 1)
    assert 0.05 < pair.sky.mean() < 0.4
    assert pair.nonocc.mean() > 0.3


def test_occluded_pixels_look_different_in_the_right_image(pair: RenderedPair) -> None:
    columns = np.arange(pair.calibration.width_px)[None, :]
    hidden = pair.occluded & (columns - np.nan_to_num(pair.disparity_px) >= 0)
    error = warp_error_dn(pair)
    assert hidden.sum() > 50
    assert error[hidden].mean() > 2 * error[pair.nonocc].mean()


def test_equal_parameters_give_equal_bits_and_another_seed_does_not() -> None:
    tiny = {"width_px": 80, "height_px": 60, "focal_px": 62.5, "cell_m": 0.2, "supersample": 1}
    first, again, other = (render_terrain(TerrainParams(seed=seed, **tiny)) for seed in (3, 3, 4))
    assert np.array_equal(again.left, first.left)
    assert np.array_equal(again.right, first.right)
    assert np.array_equal(again.disparity_px, first.disparity_px, equal_nan=True)
    assert np.array_equal(again.elevation.layers["elevation"], first.elevation.layers["elevation"], equal_nan=True)
    assert not np.array_equal(other.disparity_px, first.disparity_px, equal_nan=True)


def test_there_is_texture_at_all_distances(pair: RenderedPair) -> None:
    gray = pair.left.mean(axis=2)
    gradient = np.abs(np.diff(gray, axis=1))
    distance = 1.0 / np.maximum(np.nan_to_num(pair.disparity_px[:, 1:]), 1e-3) * 22.5
    for low, high in ((0, 2), (2, 4), (4, 8), (8, 15)):
        band = (distance >= low) & (distance < high) & ~pair.sky[:, 1:]
        assert gradient[band].mean() > 2.5, f"{low} to {high} m"


def test_the_map_can_be_resampled_and_coarse_cells_average_fine_ones(pair: RenderedPair) -> None:
    fine = pair.true_elevation(2.0, -0.5, 0.1, (10, 10))
    coarse = pair.true_elevation(2.0, -0.5, 0.2, (5, 5))
    weight = fine.layers["visible_fraction"].astype(float)
    value = np.nan_to_num(fine.layers["elevation"]) * weight
    total, count = (a.reshape(5, 2, 5, 2).sum(axis=(1, 3)) for a in (value, weight))
    known = count > 0
    assert known.any()
    # Samples per cell differ (8 each), so the averages agree up to the sampling of rock edges.
    assert np.nanmedian(np.abs(coarse.layers["elevation"][known] - total[known] / count[known])) < 0.005


def test_nothing_outside_the_view_is_in_the_map(pair: RenderedPair) -> None:
    behind = pair.true_elevation(-1.0, -0.5, 0.1, (10, 10))
    assert np.all(np.isnan(behind.layers["elevation"]))
    assert np.all(behind.layers["visible_fraction"] == 0)


def test_the_origin_of_the_level_frame_is_on_the_ground(pair: RenderedPair) -> None:
    assert abs(float(pair.height_m(np.array(0.0), np.array(0.0)))) < 1e-6


def test_impossible_parameters_are_refused(pair: RenderedPair) -> None:
    with pytest.raises(ValidationError, match="focal_px"):
        TerrainParams(focal_px=-1)
    with pytest.raises(ValueError, match="exchange them"):
        render_terrain(TerrainParams(smallest_rock_m=0.4, largest_rock_m=0.2))
    with pytest.raises(ValueError, match="must be positive"):
        pair.true_elevation(0.0, 0.0, 0.0, (2, 2))
