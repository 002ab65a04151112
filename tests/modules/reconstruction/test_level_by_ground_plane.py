"""The ground weighed against an attitude that states its uncertainty."""

import math

import numpy as np
import pytest

from modules.primitives.frames import level_from_body, mount_from_angles
from modules.reconstruction.level_by_ground_plane import LevelByGroundPlaneParams, level_by_ground_plane
from modules.types import Attitude, Calibration, Disparity, Scene

CALIBRATION = Calibration(250.0, 159.5, 119.5, 0.09, 320, 240)
MOUNT = mount_from_angles(0.0, math.radians(20), 0.0, (0.0, 0.0, 1.0))
TRUE = Attitude(0.0, math.radians(6.0), math.radians(40.0))  # the ground is level, the nose 6 degrees low


def scene(prior: Attitude | None) -> Scene:
    """Return the exact disparity of level ground 1 m below the camera."""
    v, u = np.mgrid[0:240, 0:320]
    rays = np.stack([(u - 159.5) / 250, (v - 119.5) / 250, np.ones(u.shape)], axis=-1)
    level = level_from_body(TRUE)
    rays = rays @ (level @ MOUNT.rotation).T
    depth = -(level @ MOUNT.translation_m)[2] / np.minimum(rays[..., 2], -1e-6)
    disparity = np.where(depth < 40, 250 * 0.09 / depth, np.nan).astype(np.float32)
    flags = np.isnan(disparity).astype(np.uint16)
    return Scene(Disparity(disparity, flags), np.zeros(u.shape, np.uint8), CALIBRATION, prior, MOUNT)


def levelled(prior: Attitude | None, ground_sigma_deg: float = 2.0) -> Attitude:
    made = level_by_ground_plane(scene(prior), LevelByGroundPlaneParams(ground_slope_sigma_deg=ground_sigma_deg))
    assert made.attitude is not None
    return made.attitude


def test_equal_uncertainties_meet_in_the_middle():
    found = levelled(Attitude(yaw_rad=0.5, sigma_rad=math.radians(2.0)))
    assert math.degrees(found.pitch_rad) == pytest.approx(3.0, abs=0.02)
    assert math.degrees(found.sigma_rad) == pytest.approx(2.0 / math.sqrt(2), abs=0.02)
    assert found.yaw_rad == 0.5


@pytest.mark.parametrize(("sigma_deg", "pitch_deg"), [(0.1, 0.0), (4.0, 4.8), (40.0, 6.0)])
def test_the_surer_one_prevails(sigma_deg, pitch_deg):
    """At 4 degrees against 2 the ground has the weight 16 / 20."""
    found = levelled(Attitude(sigma_rad=math.radians(sigma_deg)))
    assert math.degrees(found.pitch_rad) == pytest.approx(pitch_deg, abs=0.05)
    assert found.sigma_rad <= math.radians(min(sigma_deg, 2.01))


@pytest.mark.parametrize("prior", [None, Attitude(pitch_rad=1.3)])
def test_without_a_stated_uncertainty_the_ground_decides_alone(prior):
    assert math.degrees(levelled(prior).pitch_rad) == pytest.approx(6.0, abs=0.01)
    assert levelled(prior).yaw_rad == 0.0
