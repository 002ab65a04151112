"""Exactness on a synthetic plane, uncertainties, gates, holes and slopes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from modules.measurement.terrain_quality import PROBE
from modules.operator import OperatorError
from modules.primitives.frames import level_from_body, mount_from_angles
from modules.reconstruction import OPERATORS, SLOTS
from modules.types import Attitude, Calibration, Disparity, ElevationMap, Mount, PointCloud, Scene

BY_NAME = {operator.name.split(".")[1]: operator for operator in OPERATORS}
CALIBRATION = Calibration(250.0, 160.5, 118.0, 0.09, 320, 240, doffs_px=3.0)
ATTITUDE = Attitude(math.radians(5), math.radians(-8), math.radians(30))
MOUNT = mount_from_angles(0.0, math.radians(25), 0.0, (0.2, 0.05, 1.1))


def run(name, scene, **params):
    operator = BY_NAME[name]
    return operator.function(scene, operator.params(**params))


def plane_scene(normal=(0.0, 0.0, 1.0), attitude=ATTITUDE, mount=MOUNT, noise_px=0.0):
    """Render the plane normal . p = 0 of the level frame."""
    c = CALIBRATION
    level = level_from_body(attitude)
    v, u = np.mgrid[: c.height_px, : c.width_px]
    rays = np.stack([(u - c.cx_px) / c.focal_px, (v - c.cy_px) / c.focal_px, np.ones(u.shape)], -1)
    rays = rays @ (level @ mount.rotation).T
    depth = -(level @ mount.translation_m @ normal) / (rays @ np.asarray(normal))
    with np.errstate(divide="ignore", invalid="ignore"):
        shifted = np.where((depth > 0) & (depth < 12), c.focal_px * c.baseline_m / depth, np.nan)
    shifted = shifted + noise_px * np.random.default_rng(7).standard_normal(shifted.shape)
    disparity = (shifted - c.doffs_px).astype(np.float32)
    validity = np.where(np.isfinite(disparity), 0, 1).astype(np.uint16)
    return Scene(Disparity(disparity, validity), np.full(u.shape, 77, np.uint8), c, attitude, mount)


def reconstruct(scene, frame="level_by_attitude", **grid):
    for name in (frame, "triangulate_disparity", "gate_points"):
        scene = run(name, scene)
    return run("compute_slope", run("fill_holes", run("grid_elevation", scene, **grid)))


def test_the_slots_are_filled_in_order_and_names_belong_to_the_stage():
    assert [slot for slot in SLOTS if any(o.slot == slot for o in OPERATORS)] == list(SLOTS)
    assert all(operator.stage == "reconstruction" for operator in OPERATORS)


def test_level_ground_is_at_zero_with_a_known_attitude_and_mount():
    grid = reconstruct(plane_scene()).elevation
    elevation = grid.layers["elevation"]
    assert np.isfinite(elevation).sum() > 1000
    assert np.nanmax(np.abs(elevation)) < 1e-4  # float32 disparity
    assert np.nanmax(grid.layers["slope_deg"]) < 0.05


def test_points_lie_on_the_rays_of_their_pixels_worked_by_hand():
    disparity = np.full((240, 320), np.nan, np.float32)
    disparity[118, 170] = 6.0  # d + doffs = 9: Z = 250 * 0.09 / 9 = 2.5 m; X = 9.5 / 250 * 2.5 = 0.095 m
    scene = Scene(
        Disparity(disparity, np.isnan(disparity).astype(np.uint16)), np.zeros((240, 320), np.uint8), CALIBRATION
    )
    points = run("triangulate_disparity", scene).points
    np.testing.assert_allclose(points.xyz_m, [[2.5, -0.095, 0.0]], atol=1e-6)
    assert points.pixel.tolist() == [118 * 320 + 170]
    # sigma_Z = Z^2 sigma_d / (f B) = 6.25 * 0.25 / 22.5
    assert math.sqrt(points.covariance_m2[0, 0]) == pytest.approx(6.25 * 0.25 / 22.5, rel=1e-5)


def test_an_offset_is_added_to_every_disparity():
    exact = run("triangulate_disparity", plane_scene()).points
    scene = plane_scene()
    moved = replace(scene.disparity, disparity_px=scene.disparity.disparity_px - np.float32(5.0))
    found = run("triangulate_disparity", replace(scene, disparity=moved), offset_px=5.0).points
    np.testing.assert_array_equal(found.pixel, exact.pixel)
    np.testing.assert_allclose(found.xyz_m, exact.xyz_m, rtol=1e-4, atol=1e-4)


def test_the_covariance_agrees_with_repeated_noise():
    scene = run("triangulate_disparity", plane_scene(noise_px=0.25))
    exact = run("triangulate_disparity", plane_scene())
    common, i, j = np.intersect1d(scene.points.pixel, exact.points.pixel, return_indices=True)
    error = scene.points.xyz_m[i] - exact.points.xyz_m[j]
    near = np.linalg.norm(exact.points.xyz_m[j], axis=1) < 4
    for column, axis in ((0, 0), (5, 2)):
        ratio = error[near, axis] / np.sqrt(exact.points.covariance_m2[j][near, column])
        assert 0.85 < np.std(ratio) < 1.05
    assert len(common) > 1000


def test_ground_plane_levelling_recovers_roll_pitch_and_height():
    scene = plane_scene(attitude=replace(ATTITUDE, yaw_rad=0.0), noise_px=0.25)
    levelled = run("level_by_ground_plane", replace(scene, attitude=None))
    assert math.degrees(levelled.attitude.roll_rad) == pytest.approx(5.0, abs=0.1)
    assert math.degrees(levelled.attitude.pitch_rad) == pytest.approx(-8.0, abs=0.1)
    assert levelled.ground.height_m == pytest.approx(0.0, abs=0.01)
    assert levelled.ground.sigma_tilt_rad < math.radians(0.2)
    assert levelled.attitude.sigma_rad > math.radians(2.0)  # the slope of the ground is unknown


def test_ground_plane_levelling_puts_the_ground_at_zero_without_a_mount():
    mount = Mount(translation_m=(0.0, 0.0, 0.0))
    camera = mount_from_angles(0, math.radians(20), 0, (0, 0, 0.9))
    scene = replace(plane_scene(attitude=Attitude(), mount=camera), mount=mount, attitude=None)
    done = reconstruct(scene, "level_by_ground_plane")
    assert done.ground.height_m == pytest.approx(0.9, abs=1e-4)
    assert math.degrees(done.attitude.pitch_rad) == pytest.approx(20.0, abs=0.01)
    assert np.nanmax(np.abs(done.elevation.layers["elevation"])) < 1e-3


def test_noise_is_averaged_and_stays_within_the_stated_sigma():
    grid = reconstruct(plane_scene(noise_px=0.25)).elevation
    error, sigma = np.abs(grid.layers["elevation"]), grid.layers["sigma_m"]
    x = grid.x0_m + (np.arange(grid.shape[1]) + 0.5) * grid.cell_m
    y = grid.y0_m + (np.arange(grid.shape[0]) + 0.5) * grid.cell_m
    near = (np.hypot(x[None, :], y[:, None]) < 4.0) & np.isfinite(error)
    # One point at 4 m is off by 4 m x 1.1 m x 0.25 px / 22.5 px m = 0.05 m; a cell averages ten and more.
    assert np.median(error[near]) < 0.01
    known = np.isfinite(error)
    assert np.mean(error[known] < 2 * sigma[known]) > 0.95


def test_the_attitude_uncertainty_widens_sigma_with_distance():
    sure = reconstruct(plane_scene()).elevation.layers["sigma_m"]
    unsure = reconstruct(plane_scene(attitude=replace(ATTITUDE, sigma_rad=0.02))).elevation.layers["sigma_m"]
    both = np.isfinite(sure) & np.isfinite(unsure)
    assert both.sum() > 0.95 * np.isfinite(sure).sum()
    assert (unsure[both] > sure[both]).all()


@pytest.mark.parametrize("method", ["mean", "median"])
def test_one_wrong_point_in_a_cell_is_ignored(method):
    z = np.array([0.1, 0.11, 0.09, 0.1, 5.0], np.float32)
    xyz = np.column_stack([np.full(5, 0.02), np.full(5, 0.02), z]).astype(np.float32)
    scene = replace(plane_scene(), points=PointCloud(xyz, "level", np.arange(5, dtype=np.int32)))
    grid = run("grid_elevation", scene, method=method).elevation
    assert grid.layers["elevation"][0, 0] == pytest.approx(0.1, abs=0.005)


def test_cells_are_where_the_grid_says():
    xyz = np.array([[1.01, -0.99, 0.5], [1.26, -0.84, 0.7]], np.float32)
    scene = replace(plane_scene(), points=PointCloud(xyz, "level", np.arange(2, dtype=np.int32)))
    grid = run("grid_elevation", scene, cell_m=0.1).elevation
    assert (grid.x0_m, grid.y0_m, grid.shape) == (pytest.approx(1.0), pytest.approx(-1.0), (2, 3))
    assert grid.layers["elevation"][0, 0] == pytest.approx(0.5)
    assert grid.layers["elevation"][1, 2] == pytest.approx(0.7)


def test_gates_count_by_reason():
    scene = run("triangulate_disparity", plane_scene())
    gated = run("gate_points", scene, max_range_m=4.0, max_sigma_m=0.1)
    dropped = gated.rejected["out_of_range"] + gated.rejected["uncertain"]
    assert len(gated.points) + dropped == len(scene.points)


def grid_of(elevation):
    layers = {"elevation": np.asarray(elevation, np.float32), "sigma_m": np.full(np.shape(elevation), 0.01, np.float32)}
    return replace(plane_scene(), elevation=ElevationMap(0.0, 0.0, 0.05, layers))


def slope_plane(shape=(30, 30)):
    i, j = np.indices(shape)
    return 0.05 * (0.3 * j - 0.4 * i)


def test_a_hole_in_a_plane_is_filled_exactly_and_flagged():
    truth = slope_plane()
    holed = truth.copy()
    holed[10:14, 12:16] = np.nan
    layers = run("fill_holes", grid_of(holed)).elevation.layers
    np.testing.assert_allclose(layers["elevation"], truth, atol=1e-5)
    assert layers["filled"].sum() == 16
    assert layers["sigma_m"][11, 13] > 0.01


def test_a_wide_hole_and_the_outside_stay_unknown():
    holed = slope_plane()
    holed[5:20, 5:20] = np.nan
    holed[:, 25:] = np.nan
    layers = run("fill_holes", grid_of(holed)).elevation.layers
    assert np.isnan(layers["elevation"][12, 12])
    assert np.isnan(layers["elevation"][:, 25:]).all()


def test_the_slope_of_a_plane_is_exact_and_its_roughness_zero():
    layers = run("compute_slope", grid_of(slope_plane())).elevation.layers
    assert np.isnan(layers["slope_deg"][0, 0])  # 9 of 25 cells are too few
    inside = layers["slope_deg"][2:-2, 2:-2]
    np.testing.assert_allclose(inside, math.degrees(math.atan(0.5)), atol=1e-3)
    np.testing.assert_allclose(layers["roughness_m"][2:-2, 2:-2], 0.0, atol=1e-5)
    assert layers["step_m"][15, 15] == pytest.approx(0.05 * 0.7 * 4, abs=1e-5)


def test_terrain_quality_describes_a_tilted_plane():
    normal = np.array([math.sin(0.1), 0.0, math.cos(0.1)])
    scene = reconstruct(plane_scene(normal=normal, attitude=Attitude()))
    fact = PROBE.function(scene)[0]
    assert fact.plane_tilt_deg == pytest.approx(math.degrees(0.1), abs=0.02)
    assert fact.plane_residual_m < 1e-3
    assert fact.behind_camera_fraction == 0.0
    assert fact.point_count == len(scene.points)
    assert fact.near_density > 0.6
    assert PROBE.function(replace(scene, points=None)) == []


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("level_by_attitude", {"attitude": None}, "no attitude; give roll"),
        ("level_by_attitude", {"attitude": Attitude(pitch_rad=1.3)}, r"pitch is 74.5 deg, beyond the limit of 60 deg"),
        ("level_by_ground_plane", {"calibration": None}, "needs a calibration"),
        ("triangulate_disparity", {"calibration": None}, "needs a calibration"),
        ("triangulate_disparity", {"calibration": replace(CALIBRATION, width_px=300)}, "320x240 .* 300x240"),
        ("gate_points", {}, "no points to gate"),
        ("grid_elevation", {}, "no points to grid"),
        ("fill_holes", {}, "no elevation grid"),
        ("compute_slope", {}, "no elevation grid"),
    ],
)
def test_unusable_input_is_named(name, change, words):
    with pytest.raises(OperatorError, match=words):
        run(name, replace(plane_scene(), **change))


def test_a_grid_of_too_many_cells_is_refused_with_a_cell_size_that_works():
    scene = run("triangulate_disparity", plane_scene())
    with pytest.raises(OperatorError, match="exceeds 4000000 cells; use cells of"):
        run("grid_elevation", scene, cell_m=0.001)


def test_a_wall_is_no_ground():
    disparity = np.full((240, 320), 10.0, np.float32)
    scene = replace(plane_scene(), disparity=Disparity(disparity, np.zeros((240, 320), np.uint16)), mount=Mount())
    with pytest.raises(OperatorError, match="tilted by 90 deg"):
        run("level_by_ground_plane", scene)


def test_inputs_are_not_modified():
    scene = plane_scene()
    before = scene.disparity.disparity_px.copy()
    reconstruct(scene)
    np.testing.assert_array_equal(scene.disparity.disparity_px, before)
    assert scene.points is None
