"""Covariances, outliers, sight lines and traversability."""

import math
from dataclasses import replace

import numpy as np
import pytest

from modules.operator import OperatorError
from modules.primitives.covariance import own_height_variance, range_sigma
from modules.primitives.frames import level_from_body, rotation_from_angles
from modules.reconstruction import OPERATORS
from modules.types import (
    Attitude,
    Calibration,
    Disparity,
    ElevationMap,
    Hazard,
    Mount,
    PointCloud,
    Scene,
    SharedError,
    Sight,
)

BY_NAME = {operator.name.split(".")[1]: operator for operator in OPERATORS}
CAMERA = Calibration(250.0, 160.0, 120.0, 0.1, 320, 240)
TILT = math.radians(20.0)
MOUNT = Mount(rotation_from_angles(0.0, TILT, 0.0) @ Mount().rotation, (0.1, 0.0, 1.0))


def run(name, scene, **params):
    operator = BY_NAME[name]
    return operator.function(scene, operator.params(**params))


def ground_disparity(noise_px=0.0, seed=0):
    """Disparity of the plane z = 0 seen through `MOUNT`."""
    v, u = np.mgrid[: CAMERA.height_px, : CAMERA.width_px]
    rays = np.stack([(u - CAMERA.cx_px) / CAMERA.focal_px, (v - CAMERA.cy_px) / CAMERA.focal_px, np.ones(u.shape)], -1)
    down = -(rays @ MOUNT.rotation.T)[..., 2]
    with np.errstate(divide="ignore"):
        depth = np.where(down > 0.05, 1.0 / np.maximum(down, 1e-9), np.nan)
    disparity = CAMERA.focal_px * CAMERA.baseline_m / depth
    return (disparity + noise_px * np.random.default_rng(seed).standard_normal(depth.shape)).astype(np.float32)


def scene_of(disparity, **changes):
    image = np.full(disparity.shape, 90, np.uint8)
    scene = Scene(Disparity(disparity, np.isnan(disparity).astype(np.uint16)), image, CAMERA, Attitude(), MOUNT)
    return replace(scene, **changes)


def matrix(elements):
    xx, xy, xz, yy, yz, zz = elements
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_the_covariance_of_the_attitude_agrees_with_drawn_attitudes():
    sigma, rng = 0.02, np.random.default_rng(3)
    disparity = ground_disparity()
    exact = run("triangulate_disparity", scene_of(disparity)).points
    stated = run("triangulate_disparity", scene_of(disparity, attitude=Attitude(sigma_rad=sigma))).points
    one = int(np.argmin(np.hypot(exact.xyz_m[:, 0] - 4.0, exact.xyz_m[:, 1] - 1.0)))
    point = exact.xyz_m[one].astype(float)
    drawn = [level_from_body(Attitude(*rng.normal(0.0, sigma, 2))) @ point for _ in range(20_000)]
    own = matrix(exact.covariance_m2[one].astype(float))
    np.testing.assert_allclose(
        matrix(stated.covariance_m2[one].astype(float)) - own, np.cov(np.transpose(drawn)), atol=3e-4
    )


def test_the_covariance_of_scale_and_offset_agrees_with_drawn_calibrations():
    disparity, rng = ground_disparity(), np.random.default_rng(4)
    exact = run("triangulate_disparity", scene_of(disparity)).points
    stated = run("triangulate_disparity", scene_of(disparity), scale_sigma=0.01, offset_sigma_px=0.2).points
    one = int(np.argmin(np.hypot(exact.xyz_m[:, 0] - 4.0, exact.xyz_m[:, 1])))
    camera = np.array(exact.shared.camera_m)
    ray = exact.xyz_m[one] - camera
    d = disparity.ravel()[exact.pixel[one]]
    scale, offset = 1.0 + rng.normal(0.0, 0.01, 20_000), rng.normal(0.0, 0.2, 20_000)
    drawn = camera + ray * (scale * d / (d + offset))[:, None]
    shared = matrix((stated.covariance_m2[one] - exact.covariance_m2[one]).astype(float))
    np.testing.assert_allclose(shared, np.cov(drawn.T), rtol=0.05, atol=2e-4)


def test_covariances_are_symmetric_positive_and_the_own_part_does_not_hold_the_attitude():
    disparity = ground_disparity()
    sure = run("triangulate_disparity", scene_of(disparity)).points
    unsure = run("triangulate_disparity", scene_of(disparity, attitude=Attitude(sigma_rad=0.05))).points
    for elements in unsure.covariance_m2[::997]:
        assert np.linalg.eigvalsh(matrix(elements.astype(float))).min() > 0
    np.testing.assert_allclose(own_height_variance(unsure, 1e-4), own_height_variance(sure, 1e-4), rtol=0.02, atol=1e-6)


def test_the_range_sigma_is_that_of_the_disparity_along_the_ray():
    points = run("triangulate_disparity", scene_of(ground_disparity()), sigma_px=0.5).points
    ray = np.linalg.norm(points.xyz_m - np.array(points.shared.camera_m, np.float32), axis=1)
    d = ground_disparity().ravel()[points.pixel]
    near = ray < 5.0
    np.testing.assert_allclose(range_sigma(points)[near], (ray * 0.5 / d)[near], rtol=0.02)


def test_a_stated_sigma_replaces_the_parameter_where_it_is_known():
    disparity = ground_disparity()
    sigma = np.full(disparity.shape, 0.5, np.float32)
    sigma[:, :160] = np.nan
    scene = scene_of(disparity)
    scene = replace(scene, disparity=replace(scene.disparity, sigma_px=sigma))
    points = run("triangulate_disparity", scene, sigma_px=0.1).points
    ratio = range_sigma(points) / range_sigma(run("triangulate_disparity", scene_of(disparity), sigma_px=0.1).points)
    left = points.pixel % CAMERA.width_px < 160
    np.testing.assert_allclose(ratio[left], 1.0, rtol=1e-4)
    assert (ratio[~left] > 4.0).all()


def test_masked_pixels_and_points_behind_the_camera_are_counted_apart():
    disparity = ground_disparity()
    disparity[200, :10] = -3.0
    mask = np.ones(disparity.shape, bool)
    mask[220:] = False
    done = run("triangulate_disparity", scene_of(disparity, mask=mask))
    assert done.rejected["masked"] == 20 * 320
    assert done.rejected["behind_camera"] == 10
    assert len(done.points) + sum(done.rejected.values()) == disparity.size


@pytest.mark.parametrize(
    ("disparity", "mask", "words"),
    [
        (np.nan, None, "no_disparity 76800.: the matcher found nothing"),
        (-5.0, None, "behind_camera 76800.: d . doffs is negative; check doffs .0 px."),
        (0.1, None, "too_far 76800.: everything is beyond the reach"),
        (9.0, np.zeros((240, 320), bool), "masked 76800.: the mask hides every matched pixel"),
    ],
)
def test_a_disparity_map_without_points_is_refused_with_its_reason(disparity, mask, words):
    with pytest.raises(OperatorError, match=words):
        run("triangulate_disparity", scene_of(np.full((240, 320), disparity, np.float32), mask=mask))


def test_the_robot_body_is_a_box_that_turns_with_the_body():
    xyz = np.array([[0.3, 0.2, 0.0], [0.3, -0.2, 0.0], [1.0, 0.0, 0.0], [2.0, 0.5, 0.0]], np.float32)
    cloud = PointCloud(xyz, "level", np.arange(4, dtype=np.int32), shared=SharedError(camera_m=(-1.0, 0.0, 1.0)))
    box = {"body_front_m": 0.5, "body_back_m": 0.5, "body_side_m": 0.3}
    ahead = run("gate_points", scene_of(ground_disparity(), points=cloud), **box)
    assert ahead.points.pixel.tolist() == [2, 3]
    turned = scene_of(ground_disparity(), points=cloud, attitude=Attitude(yaw_rad=math.radians(90.0)))
    assert run("gate_points", turned, body_front_m=0.1, body_back_m=0.1, body_side_m=1.5).points.pixel.tolist() == [
        0,
        1,
        3,
    ]
    assert ahead.rejected == {"robot_body": 2}


def test_grazing_rays_and_unsure_matches_are_gated():
    scene = run("triangulate_disparity", scene_of(ground_disparity()))
    confidence = np.ones((240, 320), np.float32)
    confidence[:, 200:] = 0.2
    scene = replace(scene, disparity=replace(scene.disparity, confidence=confidence))
    done = run("gate_points", scene, min_grazing_deg=10.0, min_confidence=0.5)
    ray = done.points.xyz_m - np.array(done.points.shared.camera_m, np.float32)
    assert np.degrees(np.arcsin(-ray[:, 2] / np.linalg.norm(ray, axis=1))).min() >= 9.99
    assert done.rejected["unconfident"] > 0
    assert done.rejected["grazing"] > 0


@pytest.mark.parametrize(
    ("name", "reason"),
    [("remove_radius_outliers", "isolated"), ("remove_statistical_outliers", "statistical_outlier")],
)
def test_lone_points_go_and_the_ground_stays(name, reason):
    disparity = ground_disparity(noise_px=0.1)
    rng = np.random.default_rng(5)
    row, column = rng.integers(120, 230, 40), rng.integers(10, 310, 40)
    disparity[row, column] += 15.0
    scene = run("triangulate_disparity", scene_of(disparity))
    done = run(name, scene)
    wrong = np.zeros(disparity.shape, bool)
    wrong[row, column] = True
    assert not wrong.ravel()[done.points.pixel].any()
    assert done.rejected[reason] <= 40 + 0.002 * len(scene.points)
    assert len(done.points) + done.rejected[reason] == len(scene.points)


def test_removing_outliers_from_nothing_but_outliers_is_refused():
    disparity = np.full((240, 320), np.nan, np.float32)
    disparity[100, 100] = 9.0
    with pytest.raises(OperatorError, match=r"all 1 points are outliers .isolated.; lower min_neighbours"):
        run("remove_radius_outliers", run("triangulate_disparity", scene_of(disparity)))


def test_the_layers_of_a_cell_worked_by_hand():
    z = np.array([0.1, 0.2, 0.4], np.float32)
    xyz = np.column_stack([np.full(3, 0.02), np.full(3, 0.02), z]).astype(np.float32)
    covariance = np.zeros((3, 6), np.float32)
    covariance[:, 5] = [0.01, 0.02, 0.04]
    cloud = PointCloud(xyz, "level", np.arange(3, dtype=np.int32), covariance_m2=covariance)
    layers = run("grid_elevation", scene_of(ground_disparity(), points=cloud)).elevation.layers
    found = {name: float(layer[0, 0]) for name, layer in layers.items()}
    assert found["elevation"] == pytest.approx((0.1 / 0.01 + 0.2 / 0.02 + 0.4 / 0.04) / (100 + 50 + 25), rel=1e-5)
    assert (found["median_m"], found["min_m"], found["max_m"]) == pytest.approx((0.2, 0.1, 0.4))
    assert found["variance_m2"] == pytest.approx(np.var(z), rel=1e-4)
    assert (found["count"], found["age_s"]) == (3.0, 0.0)


def grid_scene(elevation, cell_m=0.05, x0=0.5, y0=-1.5, **layers):
    known = {"elevation": np.asarray(elevation, np.float32), **layers}
    cloud = PointCloud(
        np.zeros((1, 3), np.float32), "level", np.zeros(1, np.int32), shared=SharedError(camera_m=(0.1, 0.0, 1.0))
    )
    return scene_of(ground_disparity(), elevation=ElevationMap(x0, y0, cell_m, known), points=cloud)


def test_a_wall_hides_what_lies_behind_it_as_far_as_worked_by_hand():
    z = np.zeros((60, 80), np.float32)  # x from 0.5 to 4.5 m, y from -1.5 to 1.5 m
    z[:, 30] = 0.5  # a wall at 2.0 m: from 1 m height its shadow ends at 0.1 + 2 * 1.925 = 3.95 m
    z[:, 31:] = np.nan
    sight = run("trace_sight", grid_scene(z, filled=np.zeros(z.shape, bool))).elevation.layers["sight"]
    row = sight[30]
    assert (row[:31] == Sight.MEASURED).all()
    flat = np.zeros((60, 80), np.float32)
    flat[:, 30] = 0.5
    flat[28:33, 75:] = np.nan  # behind the shadow, over flat ground
    flat[28:33, 40:45] = np.nan  # in the shadow
    done = run("trace_sight", grid_scene(flat)).elevation.layers["sight"]
    assert (done[30, 40:45] == Sight.OCCLUDED).all()
    assert (done[30, 75:] == Sight.UNMATCHED).all()


def test_cells_outside_the_image_are_out_of_view():
    z = np.full((200, 200), np.nan, np.float32)
    z[98:102, 80:90] = 0.0
    sight = run("trace_sight", grid_scene(z, x0=-5.0, y0=-5.0)).elevation.layers["sight"]
    assert sight[100, 10] == Sight.OUT_OF_VIEW  # behind
    assert sight[5, 120] == Sight.OUT_OF_VIEW  # far to the right
    assert sight[100, 150] == Sight.UNMATCHED  # 2.5 m ahead


def hazards(z, **rover):
    return run("assess_traversability", grid_scene(z), **rover).elevation.layers


def test_level_ground_is_safe_away_from_the_border():
    layers = hazards(np.zeros((60, 80)))
    assert (layers["hazard"] == Hazard.NONE).all()
    assert (layers["goodness"] == 1.0).all()
    assert layers["traversability"][30, 40] == 1.0
    assert layers["limiting_hazard"][30, 40] == Hazard.NONE
    assert layers["limiting_hazard"][0, 0] == Hazard.BORDER  # a quarter of the rover's ground is known
    assert layers["traversability"][0, 0] == 0.0


def test_a_block_is_a_step_where_it_is_and_for_the_rover_beside_it():
    z = np.zeros((80, 80))
    z[38:42, 38:42] = 0.2
    layers = hazards(z)
    assert (layers["hazard"][38:42, 38:42] == Hazard.STEP).all()
    assert np.count_nonzero(layers["hazard"]) == 16  # and nowhere else
    assert layers["limiting_hazard"][40, 46] == Hazard.STEP  # 0.25 m from it, half a rover is 0.4 m
    assert layers["traversability"][40, 46] == 0.0
    assert layers["traversability"][40, 55] == 1.0


def test_a_lower_block_and_a_larger_rover_are_safe():
    z = np.zeros((80, 80))
    z[38:42, 38:42] = 0.06
    assert (hazards(z)["hazard"] == Hazard.NONE).all()
    z[38:42, 38:42] = 0.2
    assert (hazards(z, wheel_radius_m=0.3, clearance_m=0.5)["hazard"] == Hazard.NONE).all()


@pytest.mark.parametrize("direction", [0.0, 37.0, 90.0, 215.0])
def test_a_slope_is_a_hazard_from_the_largest_tilt_on_in_every_direction(direction):
    i, j = np.indices((60, 60)) * 0.05
    along = j * math.cos(math.radians(direction)) + i * math.sin(math.radians(direction))
    steep = hazards(along * math.tan(math.radians(21.0)))
    assert (steep["hazard"] == Hazard.SLOPE).all()
    fair = hazards(along * math.tan(math.radians(15.0)))
    assert (fair["hazard"] == Hazard.NONE).all()
    np.testing.assert_allclose(fair["goodness"], 0.5, atol=1e-3)  # half way from half the limit to the limit


def test_bumps_that_reach_the_belly_are_rough():
    i, j = np.indices((80, 80))
    z = 0.07 * np.sin(i * 0.9) * np.sin(j * 0.9)
    layers = hazards(z, wheel_radius_m=0.3, clearance_m=0.08)
    assert (layers["hazard"][10:-10, 10:-10] == Hazard.ROUGHNESS).all()


def test_unknown_cells_are_no_hazard_themselves_but_limit_the_rover():
    z = np.zeros((80, 80))
    z[:, 40:] = np.nan
    layers = hazards(z)
    assert (layers["hazard"][:, 40:] == Hazard.UNKNOWN).all()
    assert np.isnan(layers["traversability"][:, 40:]).all()
    assert layers["limiting_hazard"][40, 38] == Hazard.BORDER


def test_cells_larger_than_a_wheel_are_refused():
    with pytest.raises(OperatorError, match=r"cells of 0.5 m are larger than a wheel of 0.23 m; .* use smaller cells"):
        run("assess_traversability", grid_scene(np.zeros((20, 20)), cell_m=0.5))
