"""What the terrain says of itself: rings, rejections, walls, spikes, and whether it fits the attitude and the mount."""

import math
from dataclasses import replace

import numpy as np
import pytest

from modules.measurement.terrain_quality import Rejection, TerrainQuality, TerrainRing, measure_terrain_quality
from modules.primitives.frames import level_from_body
from modules.types import Attitude, Calibration, Disparity, ElevationMap, Mount, PointCloud, Scene, SharedError, Sight

CAMERA = Calibration(250.0, 160.0, 120.0, 0.1, 320, 240)
MOUNT = Mount(translation_m=(0.0, 0.0, 1.0))


def scene_of(xyz, attitude=None, rejected=None, grid=None):
    cloud = PointCloud(
        np.asarray(xyz, np.float32),
        "level",
        np.arange(len(xyz), dtype=np.int32),
        shared=SharedError(camera_m=(0, 0, 1)),
    )
    disparity = np.ones((240, 320), np.float32)
    return Scene(
        Disparity(disparity, np.zeros((240, 320), np.uint16)),
        np.zeros((240, 320), np.uint8),
        CAMERA,
        attitude,
        MOUNT,
        points=cloud,
        elevation=grid,
        rejected=rejected or {},
    )


def ground(rise_x=0.0, height=0.0, seed=0):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(1, 6, 4000), rng.uniform(-2, 2, 4000)
    return np.column_stack([x, y, height + rise_x * x + rng.normal(0, 0.005, 4000)])


def of(scene, kind):
    return [fact for fact in measure_terrain_quality(scene) if isinstance(fact, kind)]


def test_a_wrong_sign_of_the_pitch_is_seen_under_the_negated_attitude():
    true = Attitude(pitch_rad=math.radians(-6.0))
    body = ground() @ level_from_body(true)  # level ground as the body sees it
    wrong = Attitude(pitch_rad=math.radians(6.0))
    (fact,) = of(scene_of(body @ level_from_body(wrong).T, wrong), TerrainQuality)
    assert fact.plane_tilt_deg == pytest.approx(12.0, abs=0.1)
    assert fact.negated_tilt_deg == pytest.approx(0.0, abs=0.1)
    assert fact.levelled_by == "attitude"


def test_radians_given_for_degrees_are_seen_under_57_times_the_attitude():
    true = Attitude(roll_rad=math.radians(4.0), pitch_rad=math.radians(-6.0))
    body = ground() @ level_from_body(true)
    wrong = Attitude(roll_rad=math.radians(true.roll_rad), pitch_rad=math.radians(true.pitch_rad))
    (fact,) = of(scene_of(body @ level_from_body(wrong).T, wrong), TerrainQuality)
    assert fact.plane_tilt_deg == pytest.approx(7.1, abs=0.2)
    assert fact.radians_tilt_deg == pytest.approx(0.0, abs=0.1)
    (fact,) = of(scene_of(body @ level_from_body(true).T, true), TerrainQuality)
    assert fact.radians_tilt_deg is None  # 6 rad are no pitch


@pytest.mark.parametrize(("height", "ratio"), [(0.0, 0.0), (-0.5, -0.5), (0.2, 0.2)])
def test_the_ground_height_is_relative_to_the_camera(height, ratio):
    (fact,) = of(scene_of(ground(height=height), Attitude()), TerrainQuality)
    assert fact.ground_height_ratio == pytest.approx(ratio, abs=0.01)


def test_what_hangs_above_the_height_of_the_camera_is_counted_on_a_slope_too():
    for rise in (0.0, 0.2):
        xyz = ground(rise_x=rise)
        xyz[::40, 2] += 1.2  # one in forty, over a camera 1 m above the ground
        xyz[1::40, 2] += 0.6
        (fact,) = of(scene_of(xyz, Attitude()), TerrainQuality)
        assert fact.above_camera_fraction == pytest.approx(0.025, abs=1e-3)


def test_the_far_end_beyond_infinity_is_measured_without_the_few_worst():
    scene = scene_of(ground())
    disparity = np.full((240, 320), 9.0, np.float32)
    disparity[:60] = -4.0
    disparity[0, :50] = -40.0  # wrong matches
    scene = replace(scene, disparity=replace(scene.disparity, disparity_px=disparity))
    (fact,) = of(scene, TerrainQuality)
    assert fact.behind_camera_fraction == 0.25
    assert fact.far_disparity_px == pytest.approx(-4.0 + CAMERA.doffs_px)
    (fact,) = of(scene_of(ground()), TerrainQuality)
    assert (fact.behind_camera_fraction, fact.far_disparity_px) == (0.0, None)


def test_rejections_are_facts_by_reason():
    facts = of(scene_of(ground(), rejected={"too_high": 768, "no_disparity": 5}), Rejection)
    assert [(fact.reason, fact.count, fact.fraction) for fact in facts] == [("too_high", 768, 0.01)]


def flat_grid(**changes):
    shape = (80, 160)  # x from 0 to 8 m, y from -2 to 2 m
    layers = {
        "elevation": np.zeros(shape, np.float32),
        "sigma_m": np.full(shape, 0.01, np.float32),
        "count": np.full(shape, 4, np.int32),
        "min_m": np.full(shape, -0.02, np.float32),
        "max_m": np.full(shape, 0.02, np.float32),
        "filled": np.zeros(shape, bool),
        "sight": np.full(shape, Sight.MEASURED, np.uint8),
    }
    return ElevationMap(0.0, -2.0, 0.05, {**layers, **changes})


def test_rings_count_what_the_camera_could_see():
    sight = np.full((80, 160), Sight.MEASURED, np.uint8)
    sight[:, :40] = Sight.OUT_OF_VIEW  # the first 2 m
    sight[:40, 40:60] = Sight.OCCLUDED
    near, middle, far = of(scene_of(ground(), grid=flat_grid(sight=sight)), TerrainRing)
    assert (near.ring, middle.ring, far.ring) == ("near", "middle", "far")
    assert near.occluded_fraction == pytest.approx(0.5, abs=0.02)
    assert near.covered_fraction == pytest.approx(1.0 - near.occluded_fraction)
    assert (far.covered_fraction, far.points_per_m2) == (1.0, pytest.approx(1600.0))
    assert far.median_sigma_m == pytest.approx(0.01)


def test_walls_and_spikes_are_counted_and_flat_ground_has_none():
    (clean,) = of(scene_of(ground(), grid=flat_grid()), TerrainQuality)
    assert (clean.wall_fraction, clean.spike_fraction) == (0.0, 0.0)
    top, elevation = np.full((80, 160), 0.02, np.float32), np.zeros((80, 160), np.float32)
    top[:8] = 0.6
    elevation[40, 50], elevation[41, 90] = 0.3, -0.3  # lone cells
    elevation[60:63, 60:63] = 0.3  # a rock
    (fact,) = of(scene_of(ground(), grid=flat_grid(max_m=top, elevation=elevation)), TerrainQuality)
    assert fact.wall_fraction == pytest.approx(0.1)
    assert fact.spike_fraction == pytest.approx(2 / (80 * 160))


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_scatter_is_relative_to_what_sigma_predicts(factor):
    noise = (0.01 * factor * np.random.default_rng(2).standard_normal((80, 160))).astype(np.float32)
    (fact,) = of(scene_of(ground(), grid=flat_grid(elevation=noise)), TerrainQuality)
    assert fact.scatter_ratio == pytest.approx(factor, rel=0.05)
