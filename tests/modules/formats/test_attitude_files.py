"""Attitudes in every form and convention, worked by hand, and the words of every fault."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from modules import formats as f
from modules.formats.attitude import attitude_from_rotation
from modules.primitives.frames import (
    ENU_FROM_NED,
    FLU_FROM_FRD,
    enu_from_level,
    level_from_body,
    nearest_rotation,
    rep103_from_aerospace,
    rotation_from_angles,
    rotation_problem,
)
from modules.types import Attitude

TILT = st.floats(-80, 80)
TURN = st.floats(-179, 179)


def read(tmp_path, text: str) -> Attitude:
    (tmp_path / "a.yaml").write_text(text)
    return f.read_attitude(tmp_path / "a.yaml")


def degrees(attitude: Attitude) -> list[float]:
    return [math.degrees(a) for a in (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)]


# One slope, told in every way: the vehicle climbs a ramp of 10 degrees to the north-east, its right side 5 degrees low.
SAID = {
    "rep103": "roll_deg: 5\npitch_deg: -10\nyaw_deg: 45\n",  # nose up is negative, 45 degrees left of east
    "radians": f"roll_rad: {math.radians(5)}\npitch_rad: {math.radians(-10)}\nyaw_rad: {math.pi / 4}\n",
    "aerospace": "convention: aerospace\nroll_deg: 5\npitch_deg: 10\nyaw_deg: 45\n",  # nose up is positive, heading 45
}


@pytest.mark.parametrize("name", sorted(SAID))
def test_one_attitude_said_in_every_convention_is_one_attitude(tmp_path, name):
    assert degrees(read(tmp_path, SAID[name])) == pytest.approx([5, -10, 45])


def test_a_climbing_nose_points_up_in_both_conventions(tmp_path):
    for text in SAID.values():
        nose = level_from_body(read(tmp_path, text)) @ [1, 0, 0]
        # East and north parts alike, up by sin 10.
        np.testing.assert_allclose(nose, [math.cos(math.radians(10)) / math.sqrt(2)] * 2 + [math.sin(math.radians(10))])
        assert (level_from_body(read(tmp_path, text)) @ [0, -1, 0])[2] < 0  # the right side is low


@pytest.mark.parametrize("convention", ["rep103", "aerospace"])
@given(roll=TILT, pitch=TILT, yaw=TURN)
def test_quaternion_matrix_and_angles_agree(tmp_path_factory, convention, roll, pitch, yaw):
    folder = tmp_path_factory.mktemp("attitudes")
    turned = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    x, y, z, w = turned.as_quat()
    rows = [[float(value) for value in row] for row in turned.as_matrix()]
    said = [
        f"roll_deg: {roll!r}\npitch_deg: {pitch!r}\nyaw_deg: {yaw!r}\n",
        f"quaternion: {{w: {float(w)!r}, x: {float(x)!r}, y: {float(y)!r}, z: {float(z)!r}}}\n",
        f"rotation_matrix: {rows}\n",
    ]
    rotations = [level_from_body(read(folder, f"convention: {convention}\n{text}")) for text in said]
    np.testing.assert_allclose(rotations[1], rotations[0], atol=1e-9)
    np.testing.assert_allclose(rotations[2], rotations[0], atol=1e-9)
    if convention == "rep103":
        np.testing.assert_allclose(rotations[0], turned.as_matrix(), atol=1e-9)


@given(roll=TILT, pitch=TILT, yaw=TURN)
def test_the_aerospace_turn_is_its_own_inverse(roll, pitch, yaw):
    rotation = rotation_from_angles(*(math.radians(a) for a in (roll, pitch, yaw)))
    back = ENU_FROM_NED.T @ rep103_from_aerospace(rotation) @ FLU_FROM_FRD
    np.testing.assert_allclose(back, rotation, atol=1e-12)
    assert rotation_problem(rep103_from_aerospace(rotation)) is None


def test_an_aerospace_attitude_without_a_heading_looks_ahead(tmp_path):
    assert degrees(read(tmp_path, "convention: aerospace\npitch_deg: 3\n")) == pytest.approx([0, -3, 0])


@pytest.mark.parametrize(("heading", "ahead"), [(0, [0, 1, 0]), (90, [1, 0, 0]), (180, [0, -1, 0]), (270, [-1, 0, 0])])
def test_the_level_frame_turns_into_east_north_up_by_its_heading(heading, ahead):
    np.testing.assert_allclose(enu_from_level(math.radians(heading)) @ [1, 0, 0], ahead, atol=1e-12)
    np.testing.assert_allclose(enu_from_level(math.radians(heading)) @ [0, 0, 1], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("convention", "reading"),
    [
        # At rest an accelerometer reads 9.8 m/s^2 upwards. Nose down by 10: up leans back in the body, to negative x.
        ("rep103", [-math.sin(math.radians(10)), 0, math.cos(math.radians(10))]),
        ("aerospace", [-math.sin(math.radians(10)), 0, -math.cos(math.radians(10))]),
    ],
)
def test_gravity_alone_gives_roll_and_pitch(tmp_path, convention, reading):
    values = [9.80665 * value for value in reading]
    found = read(tmp_path, f"convention: {convention}\naccelerometer_mps2: {values}\nsigma_deg: 1\n")
    assert degrees(found) == pytest.approx([0, 10, 0], abs=1e-9)
    assert math.degrees(found.sigma_rad) == pytest.approx(1.0)


@given(roll=TILT, pitch=TILT)
def test_gravity_returns_the_tilt_it_was_made_from(roll, pitch):
    up = level_from_body(Attitude(math.radians(roll), math.radians(pitch))).T @ [0, 0, 9.80665]
    assert degrees(f.attitude_from_gravity("log", up))[:2] == pytest.approx([roll, pitch], abs=1e-6)


def test_a_rounded_matrix_is_made_a_rotation():
    exact = rotation_from_angles(0.3, -0.2, 1.0)
    nearest = nearest_rotation(exact.round(4))
    np.testing.assert_allclose(nearest @ nearest.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(nearest, exact, atol=1e-4)
    assert nearest_rotation(exact) is exact


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("roll_deg: 0\npitch_rad: 20\n", "has both a roll_deg and pitch_rad; keep one of them"),
        ("pitch_rad: 12\n", "pitch_rad is 12, beyond 2 pi; it is in degrees: call it pitch_deg"),
        ("pitch_deg: 1200\n", "pitch_deg is 1200 deg, outside -90 to 90 deg; check its unit and the order of angles"),
        (
            "quaternion: {w: 0.9, x: 0.1, y: 0, z: 0}\n",
            "the quaternion has length 0.9055 and must have 1 within 0.01; "
            "normalise it and check that no component is missing",
        ),
        (
            "rotation_matrix: [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\n",
            "rotation_matrix: it is left-handed (determinant -1, must be +1): it mirrors; "
            "one axis has the wrong sign or two rows are exchanged",
        ),
        (
            "rotation_matrix: [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]\n",
            "rotation_matrix: it is no rotation (R R^T differs from 1 by 0.1, limit 0.001); "
            "its rows must be orthogonal and of length 1: check its digits and that it holds no scale",
        ),
        ("rotation_matrix: [1, 0, 0]\n", "rotation_matrix is 1 and must be a list of 3 numbers"),
        ("rotation_matrix: 3\n", "rotation_matrix is 3 and must be a list of 3 rows of 3 numbers"),
        ("accelerometer_mps2: [0, 0, 1]\n", "reads 1 m/s^2 and must read 9.80665 within 5%; it is in g: multiply by"),
        (
            "accelerometer_mps2: [4, 0, 12]\n",
            "reads 12.65 m/s^2 and must read 9.80665 within 5%; take it at rest",
        ),
        (
            "accelerometer_mps2: [0, 0, -9.8]\n",
            "the accelerometer reads -9.8 m/s^2 along the body's up axis and must read above 0: at rest it points up, "
            "against gravity; change its sign, or name the convention of its axes",
        ),
        ("convention: nasa\nroll_deg: 1\n", "convention is 'nasa'; known are rep103, aerospace, euroc"),
        (
            "quaternion: {w: 0, x: 1, y: 0, z: 0}\n",
            "the body lies on its side or back, its up axis 180 deg from up, by the convention 'rep103'",
        ),
    ],
)
def test_impossible_attitudes_are_refused_with_the_remedy(tmp_path, text, words):
    with pytest.raises(f.FormatError) as error:
        read(tmp_path, text)
    assert words in str(error.value)
    assert str(error.value).startswith(str(tmp_path / "a.yaml"))


def test_an_attitude_in_the_other_convention_stands_on_its_head_and_is_noticed():
    """A front-right-down attitude read as front-left-up is upside down: the fault is seen, not mapped."""
    level = np.diag([1.0, -1.0, -1.0])  # level, of a body frame with z down against a world with z up
    with pytest.raises(
        f.FormatError,
        match="lies on its side or back, its up axis 180 deg from up, by the convention 'rep103'; if it has",
    ):
        attitude_from_rotation("log", level)
