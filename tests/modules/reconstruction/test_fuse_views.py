"""Fusion of a sequence over terrain that is known exactly."""

import math
from dataclasses import replace

import numpy as np
import pytest

from modules.formats.tiles import TileFolder
from modules.operator import OperatorError
from modules.primitives.frames import level_from_body, rotation_from_angles
from modules.reconstruction import OPERATORS
from modules.reconstruction.fuse_views import TILE_CELLS, FusedMap
from modules.simulation.heightfield import build_heightfield
from modules.types import Attitude, Calibration, Disparity, Mount, PointCloud, Pose, Scene

TRIANGULATE = next(o for o in OPERATORS if o.name == "reconstruction.triangulate_disparity")
CAMERA = Calibration(150.0, 79.5, 59.5, 0.3, 160, 120)
MOUNT = Mount(rotation_from_angles(0.0, math.radians(25.0), 0.0) @ Mount().rotation, (0.0, 0.0, 1.0))
NOISE_PX = 0.1


@pytest.fixture(scope="module")
def field():
    return build_heightfield(4, 0.02, 0.1, 0.0, 0.0, (0.1, 0.2), 1.0, 0.7, 0.2)


def seen(field, pose, seed):
    """Return the scene that a noisy matcher gives of the field from a pose, its points in the level frame."""
    level = level_from_body(pose.attitude)
    v, u = np.mgrid[: CAMERA.height_px, : CAMERA.width_px]
    rays = np.stack([(u - CAMERA.cx_px) / CAMERA.focal_px, (v - CAMERA.cy_px) / CAMERA.focal_px, np.ones(u.shape)], -1)
    rays = rays.reshape(-1, 3) @ (level @ MOUNT.rotation).T
    length = np.linalg.norm(rays, axis=1)
    eye = np.asarray(pose.translation_m) + level @ np.asarray(MOUNT.translation_m)
    depth = field.cast(eye, rays / length[:, None]) / length
    d = CAMERA.focal_px * CAMERA.baseline_m / depth + NOISE_PX * np.random.default_rng(seed).standard_normal(
        depth.shape
    )
    d = np.where((depth < 8.0), d, np.nan).astype(np.float32).reshape(u.shape)
    scene = Scene(
        Disparity(d, np.isnan(d).astype(np.uint16)), np.zeros(d.shape, np.uint8), CAMERA, pose.attitude, MOUNT
    )
    return TRIANGULATE.function(scene, TRIANGULATE.params(sigma_px=NOISE_PX))


def drive(count, sigma_m=0.005):
    return [
        Pose(
            Attitude(math.radians(3.0 * (-1) ** k), math.radians(2.0 * k - 3.0), math.radians(6.0 * k - 12.0)),
            (0.6 * k, 0.1 * k, 0.02 * k),
            sigma_m,
        )
        for k in range(count)
    ]


def errors(field, grid):
    i, j = np.nonzero(np.isfinite(grid.layers["elevation"]))
    x, y = grid.x0_m + (j + 0.5) * grid.cell_m, grid.y0_m + (i + 0.5) * grid.cell_m
    return grid.layers["elevation"][i, j] - field.height_m(x, y), (i, j)


def test_a_sequence_is_more_exact_than_its_first_view_and_keeps_its_sigma(field):
    one, all_of_them = FusedMap(0.1), FusedMap(0.1)
    for k, pose in enumerate(drive(6)):
        scene = seen(field, pose, k)
        all_of_them.add(scene, pose, float(k))
        if k == 0:
            one.add(scene, pose, 0.0)
    first, fused = one.elevation(), all_of_them.elevation()
    error, where = errors(field, fused)
    views = fused.layers["views"][where]
    assert views.max() >= 4
    assert np.median(np.abs(error[views >= 4])) < 0.8 * np.median(np.abs(errors(field, first)[0]))
    relative = error[views >= 3] / fused.layers["sigma_m"][where][views >= 3]
    assert 0.4 < 1.48 * np.median(np.abs(relative)) < 1.5
    assert fused.layers["moving"].mean() < 0.01


def test_the_first_and_last_views_are_told_by_age(field):
    fused = FusedMap(0.1)
    for k, pose in enumerate(drive(3)):
        fused.add(seen(field, pose, k), pose, 10.0 * k)
    age = fused.elevation().layers["age_s"]
    assert np.nanmin(age) == 0.0
    assert np.nanmax(age) == 20.0


def flat_view(height=0.0, block=None, sigma=0.01, extent=(0.0, 4.0)):
    x, y = np.meshgrid(np.arange(extent[0] + 0.025, extent[1], 0.05), np.arange(-0.975, 1.0, 0.05))
    z = np.full(x.shape, height)
    if block is not None:
        z[(np.abs(x - block[0]) < 0.2) & (np.abs(y - block[1]) < 0.2)] += 0.3
    xyz = np.column_stack([x.ravel(), y.ravel(), z.ravel()]).astype(np.float32)
    covariance = np.zeros((len(xyz), 6), np.float32)
    covariance[:, [0, 3, 5]] = sigma**2
    cloud = PointCloud(xyz, "level", np.arange(len(xyz), dtype=np.int32), covariance_m2=covariance)
    empty = Disparity(np.full((1, 1), np.nan, np.float32), np.ones((1, 1), np.uint16))
    return Scene(empty, np.zeros((1, 1), np.uint8), CAMERA, Attitude(), points=cloud)


def test_a_stone_that_was_moved_is_found_and_stands_where_it_was_seen_last():
    fused = FusedMap(0.1)
    fused.add(flat_view(block=(1.0, 0.0)), Pose(), 0.0)
    fused.add(flat_view(block=(1.0, 0.0)), Pose(), 1.0)
    fused.add(flat_view(block=(3.0, 0.0)), Pose(), 2.0)
    grid = fused.elevation()
    i, j = np.nonzero(grid.layers["moving"])
    x, y = grid.x0_m + (j + 0.5) * 0.1, grid.y0_m + (i + 0.5) * 0.1
    near = np.minimum(np.hypot(x - 1.0, y), np.hypot(x - 3.0, y))
    assert near.max() < 0.35
    row = round((0.05 - grid.y0_m) / 0.1 - 0.5)
    assert grid.layers["elevation"][row, 10] == pytest.approx(0.0, abs=1e-6)  # it is gone
    assert grid.layers["elevation"][row, 30] == pytest.approx(0.3, abs=1e-6)  # it is here
    assert grid.layers["moving"][row, 10]
    assert grid.layers["moving"][row, 30]


def test_two_views_are_weighted_by_their_uncertainty_worked_by_hand():
    fused = FusedMap(0.1)
    fused.add(flat_view(0.00, sigma=0.03), Pose(sigma_m=0.04), 0.0)  # variance of a cell 0.0009 + 0.0016
    fused.add(flat_view(0.02, sigma=0.01), Pose(), 1.0)
    grid = fused.elevation()
    weights = np.array([1.0 / 0.0025, 1.0 / 0.0001])
    assert np.nanmedian(grid.layers["elevation"]) == pytest.approx(0.02 * weights[1] / weights.sum(), rel=1e-3)
    assert np.nanmedian(grid.layers["sigma_m"]) == pytest.approx(1.0 / math.sqrt(weights.sum()), rel=1e-3)


def test_the_map_is_the_same_whether_tiles_stay_in_memory_or_not(tmp_path):
    side = TILE_CELLS * 0.1
    roomy, tight = FusedMap(0.1), FusedMap(0.1, max_tiles=1, store=TileFolder(tmp_path))
    for k in range(4):
        pose = Pose(translation_m=(side * 0.7 * k, 0.05, 0.01 * k))
        for fused in (roomy, tight):
            fused.add(flat_view(), pose, float(k))
    assert len(list(tmp_path.iterdir())) >= 3
    wanted, found = roomy.elevation(), tight.elevation()
    assert (wanted.x0_m, wanted.y0_m, wanted.shape) == (found.x0_m, found.y0_m, found.shape)
    for name, layer in wanted.layers.items():
        np.testing.assert_array_equal(found.layers[name], layer)


def test_cells_far_above_the_datum_keep_their_digits():
    fused = FusedMap(0.1)
    for k in range(5):
        fused.add(flat_view(0.001 * k), Pose(translation_m=(0.0, 0.0, 2000.0)), float(k))
    grid = fused.elevation()
    assert np.nanmedian(grid.layers["elevation"]) == pytest.approx(2000.002, abs=3e-4)
    assert not grid.layers["moving"].any()


@pytest.mark.parametrize("shift", [(-2, 0), (0, 0), (1, -1)])
def test_a_map_across_the_borders_of_tiles_is_the_map_within_one(shift):
    """Moved by whole cells so that it lies within a tile, or over the corner where four meet, it is the same map."""
    across = np.array(shift) * TILE_CELLS * 0.1
    maps = []
    for start in ((10.05, 12.85), (across[0] - 2.0 + 0.05, across[1] + 0.05)):
        fused = FusedMap(0.1)
        fused.add(flat_view(block=(1.0, 0.3)), Pose(translation_m=(*start, 0.0)), 0.0)
        fused.add(flat_view(0.01, block=(3.0, 0.3)), Pose(translation_m=(*start, 0.0), sigma_m=0.02), 1.0)
        maps.append((fused, fused.elevation()))
    (one, within), (more, over) = maps
    assert (len(one._tiles), len(more._tiles)) == (1, 4)
    assert within.shape == over.shape
    for name, layer in within.layers.items():
        np.testing.assert_allclose(over.layers[name], layer, rtol=1e-5, atol=2e-6)


def test_the_order_of_views_at_one_time_changes_nothing_but_which_is_latest():
    views = [(flat_view(0.02 * k, sigma=0.02), Pose(sigma_m=0.01 * k)) for k in range(3)]
    maps = []
    for order in ((0, 1, 2), (2, 0, 1)):
        fused = FusedMap(0.1)
        for k in order:
            fused.add(*views[k], 5.0)
        maps.append(fused.elevation())
    for name, layer in maps[0].layers.items():
        np.testing.assert_allclose(maps[1].layers[name], layer, rtol=1e-5, atol=1e-6)


def test_views_that_differ_as_their_noise_says_are_not_called_moving():
    rng = np.random.default_rng(3)
    fused = FusedMap(0.1)
    for k in range(12):
        view = flat_view(sigma=0.03)
        view.points.xyz_m[:, 2] += rng.normal(0.0, 0.03, len(view.points)).astype(np.float32)
        fused.add(view, Pose(), float(k))
    grid = fused.elevation()
    assert grid.layers["moving"].mean() < 0.01
    assert np.nanstd(grid.layers["elevation"]) < 1.3 * np.nanmedian(grid.layers["sigma_m"])


@pytest.mark.parametrize("pose_sigma", [0.0, 0.1])
def test_heights_that_an_uncertain_pose_explains_are_not_called_moving(pose_sigma):
    fused = FusedMap(0.1)
    for k in range(4):
        fused.add(flat_view(0.08 * (-1) ** k, sigma=0.01), Pose(sigma_m=pose_sigma), float(k))
    assert fused.elevation().layers["moving"].mean() == (1.0 if pose_sigma == 0.0 else 0.0)


def test_a_tilt_that_is_not_known_widens_the_far_cells():
    fused = FusedMap(0.1)
    view = flat_view(sigma=0.001)
    tilted = replace(view.points, shared=replace(view.points.shared, tilt_rad=0.02))
    fused.add(replace(view, points=tilted), Pose(sigma_m=0.01), 0.0)
    sigma = fused.elevation().layers["sigma_m"]
    assert sigma[10, 38] == pytest.approx(math.hypot(0.02 * math.hypot(3.85, 0.05), 0.01), rel=0.05)
    assert sigma[10, 2] < 0.3 * sigma[10, 38]


def test_a_long_drive_holds_no_more_tiles_than_allowed(tmp_path):
    fused = FusedMap(0.1, max_tiles=2, store=TileFolder(tmp_path))
    held = []
    for k in range(12):
        fused.add(flat_view(), Pose(translation_m=(20.5 * k, 5.0, 0.0)), float(k))
        held.append(len(fused._tiles))
    assert max(held) == 2
    assert len(list(tmp_path.iterdir())) + 2 == 9  # the others were put away
    assert np.count_nonzero(np.isfinite(fused.elevation().layers["elevation"])) == 12 * 40 * 20


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda fused: fused.add(flat_view(), Pose(), -1.0), r"-1 s comes after one at 0 s; sort the views"),
        (lambda fused: fused.add(replace(flat_view(), points=None), Pose(), 1.0), "the view has no points"),
        (lambda fused: fused.add(flat_view(), Pose(translation_m=(100.0, 0.0, 0.0)), 1.0), "needs more than 2 tiles"),
        (lambda fused: fused.elevation(max_cells=10), r"cells, above 10; use larger cells"),
        (lambda fused: FusedMap().elevation(), "no view was added"),
    ],
)
def test_what_cannot_be_fused_is_refused(act, words):
    fused = FusedMap(0.1, max_tiles=2)
    fused.add(flat_view(), Pose(), 0.0)
    with pytest.raises(OperatorError, match=words):
        act(fused)
