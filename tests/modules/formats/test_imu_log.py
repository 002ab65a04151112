"""Logs of an inertial measurement unit: interpolation, gaps and order."""

import math

import numpy as np
import pytest

from modules import formats as f
from modules.primitives.frames import level_from_body, rotation_from_angles

ANGLES = "time_s,roll_deg,pitch_deg,yaw_deg\n10.0,0,0,0\n10.1,2,-4,10\n10.2,4,-8,20\n12.0,4,-8,20\n"


def log(tmp_path, text: str, convention="rep103") -> f.ImuLog:
    (tmp_path / "imu.csv").write_text(text)
    return f.read_imu_log(tmp_path / "imu.csv", convention)


def degrees(attitude) -> list[float]:
    return [math.degrees(a) for a in (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)]


def test_a_time_of_the_log_gives_its_record(tmp_path):
    assert degrees(log(tmp_path, ANGLES).at(10.1)) == pytest.approx([2, -4, 10])
    assert degrees(log(tmp_path, ANGLES).at(12.0)) == pytest.approx([4, -8, 20])


def test_a_turn_about_one_axis_is_interpolated_evenly(tmp_path):
    found = log(tmp_path, "time_s,roll_deg,pitch_deg,yaw_deg\n0,0,0,170\n0.4,0,0,-170\n").at(0.1)
    assert degrees(found) == pytest.approx([0, 0, 175])  # over the seam at 180, not through 0


def test_interpolation_goes_along_the_shortest_rotation(tmp_path):
    between = level_from_body(log(tmp_path, ANGLES).at(10.15))
    a, b = (rotation_from_angles(*np.radians(v)) for v in ([2, -4, 10], [4, -8, 20]))
    for one, other in ((a, between), (between, b)):
        angle = math.degrees(math.acos((np.trace(one.T @ other) - 1) / 2))
        assert angle == pytest.approx(math.degrees(math.acos((np.trace(a.T @ b) - 1) / 2)) / 2, abs=1e-6)


def test_the_nearest_record_can_be_asked_for(tmp_path):
    assert degrees(log(tmp_path, ANGLES).at(10.16, method="nearest")) == pytest.approx([4, -8, 20])
    assert degrees(log(tmp_path, ANGLES).at(10.14, method="nearest")) == pytest.approx([2, -4, 10])


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_times_are_in_the_unit_of_their_column(tmp_path, unit):
    scale = {"s": 1, "ms": 1000, "us": 10**6, "ns": 10**9}[unit]
    text = f"#timestamp_{unit}, qw, qx, qy, qz, extra\n{1700000000 * scale},1,0,0,0,a\n{1700000001 * scale},1,0,0,0,b\n"
    np.testing.assert_allclose(log(tmp_path, text).time_s, [1.7e9, 1.7e9 + 1])


def test_an_accelerometer_log_and_an_aerospace_log_are_read(tmp_path):
    still = log(tmp_path, "time_s,ax_mps2,ay_mps2,az_mps2\n0,-1.70291,0,9.65765\n").at(0.0)  # 9.80665 at 10 degrees
    assert degrees(still) == pytest.approx([0, 10, 0], abs=1e-3)
    nose_up = log(tmp_path, "time_s,roll_deg,pitch_deg,yaw_deg\n0,5,10,45\n", "aerospace").at(0.0)
    assert degrees(nose_up) == pytest.approx([5, -10, 45])


@pytest.mark.parametrize(
    ("time", "words"),
    [
        (
            9.0,
            "runs from 10.000 to 12.000 s and 9.000 s is outside; check that the images and the log use",
        ),
        (11.0, "has a gap of 1.800 s at 11.000 s, above 0.5 s; the attitude may have changed meanwhile: take a pair"),
    ],
)
def test_times_without_a_record_are_refused(tmp_path, time, words):
    with pytest.raises(f.FormatError) as error:
        log(tmp_path, ANGLES).at(time)
    assert words in str(error.value)


def test_a_gap_can_be_allowed_and_the_nearest_record_has_a_limit_too(tmp_path):
    assert degrees(log(tmp_path, ANGLES).at(11.0, max_gap_s=2.0)) == pytest.approx([4, -8, 20])
    with pytest.raises(f.FormatError, match=r"gap of 0\.800 s at 11\.000 s"):
        log(tmp_path, ANGLES).at(11.0, method="nearest")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty; a log begins with the names of its columns"),
        ("a,b\n1,2\n", "has the columns a, b; it needs a time (time_s, timestamp_ns, ...) and qw, qx, qy, qz or"),
        ("time_s,qw,qx,qy,qz\n", "has no records after its first line; log while the images are taken"),
        ("time_s,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0,0\n", "imu.csv:3: 4 columns and the first line names 5; complete it"),
        ("time_s,qw,qx,qy,qz\n0,1,0,x,0\n", "imu.csv:2: qy is 'x' and must be a number"),
        ("time_s,qw,qx,qy,qz\n0,1,1,0,0\n", "imu.csv:2: the quaternion has length 1.414 and must have 1 within 0.01; "),
        ("time_s,roll_deg,pitch_deg,yaw_deg\n0,0,100,0\n", "imu.csv:2: pitch_deg is 100 deg, outside -90 to 90 deg; "),
        ("time_s,roll_rad,pitch_rad,yaw_rad\n0,0,10,0\n", "imu.csv:2: pitch_rad is 10, beyond 2 pi; it is in degrees"),
        ("time_s,ax_mps2,ay_mps2,az_mps2\n0,0,0,1\n", "imu.csv:2: the accelerometer reads 1 m/s^2 and must read 9.80"),
        (
            "time_s,qw,qx,qy,qz\n0,1,0,0,0\n2,1,0,0,0\n1,1,0,0,0\n1,1,0,0,0\n",
            "timestamps are out of order (line 4: 1.000000 s after 2.000000 s; line 5: 1.000000 s after 1.000000 s); "
            "sort the log and remove doubles",
        ),
    ],
)
def test_faulty_logs_are_refused_with_the_line(tmp_path, text, words):
    with pytest.raises(f.FormatError) as error:
        log(tmp_path, text)
    assert words in str(error.value)


def test_many_lines_out_of_order_are_counted(tmp_path):
    rows = "".join(f"{-index},1,0,0,0\n" for index in range(12))
    with pytest.raises(f.FormatError, match=r"line 7: -5\.000000 s after -4\.000000 s and 6 more\)"):
        log(tmp_path, "time_s,qw,qx,qy,qz\n" + rows)
