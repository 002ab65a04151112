"""Signs and inverses of the rotations, worked by hand."""

import math

import numpy as np
import pytest

from modules.primitives.frames import angles_from_rotation, roll_pitch_from_up, rotation_from_angles
from modules.types import Mount

NOSE, LEFT, UP = np.eye(3)
QUARTER = math.pi / 2


def test_positive_pitch_lowers_the_nose():
    np.testing.assert_allclose(rotation_from_angles(0, QUARTER, 0) @ NOSE, [0, 0, -1], atol=1e-12)


def test_positive_roll_lowers_the_right_side():
    np.testing.assert_allclose(rotation_from_angles(QUARTER, 0, 0) @ -LEFT, [0, 0, -1], atol=1e-12)


def test_positive_yaw_turns_left():
    np.testing.assert_allclose(rotation_from_angles(0, 0, QUARTER) @ NOSE, LEFT, atol=1e-12)


def test_roll_is_applied_before_pitch_and_pitch_before_yaw():
    # up -> roll: right (-y) -> pitch: unchanged -> yaw: nose
    np.testing.assert_allclose(rotation_from_angles(QUARTER, QUARTER, QUARTER) @ UP, NOSE, atol=1e-12)


def test_the_default_mount_looks_forward_with_image_right_to_the_right():
    rotation = Mount().rotation
    np.testing.assert_array_equal(rotation @ [0, 0, 1], NOSE)
    np.testing.assert_array_equal(rotation @ [1, 0, 0], -LEFT)
    np.testing.assert_array_equal(rotation @ [0, 1, 0], -UP)


@pytest.mark.parametrize("angles", [(0.1, -0.2, 0.3), (-1.5, 1.2, -3.0), (3.0, 0.0, 1.0)])
def test_angles_are_recovered_from_the_rotation(angles):
    rotation = rotation_from_angles(*angles)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(angles_from_rotation(rotation), angles, atol=1e-12)


def test_at_a_vertical_nose_the_rotation_is_still_recovered():
    rotation = rotation_from_angles(0.3, QUARTER, 0.2)
    np.testing.assert_allclose(rotation_from_angles(*angles_from_rotation(rotation)), rotation, atol=1e-7)


def test_roll_and_pitch_follow_from_the_up_vector():
    up = rotation_from_angles(0.2, -0.3, 0.0).T @ UP
    np.testing.assert_allclose(roll_pitch_from_up(up), (0.2, -0.3), atol=1e-12)
