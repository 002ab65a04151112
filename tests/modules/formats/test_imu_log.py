"""Logs of an inertial measurement unit: interpolation, gaps and order."""

import math

import numpy as np
import pytest

from modules import formats as f
from modules.primitives.frames import level_from_body, mount_in_flu, rotation_from_angles
from modules.types import Mount

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
        (11.0, "has a gap of 1.800 s at 11.000 s, above 0.5 s; the attitude may have changed meanwhile: take another"),
        (11.0, "or allow the gap (--max-gap, max_gap_s)"),
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


EUROC = """#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []
1403636580838555648,4.6,-1.7,0.7,{},{},{},{}
"""


def upright(roll_deg, pitch_deg, yaw_deg):
    """EuRoC's unit, x up, y right, z forward, in a body of these angles: the text of its ground truth."""
    from scipy.spatial.transform import Rotation

    axes = np.array(
        [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]
    )  # columns: x up, y right, z forward, in the body
    x, y, z, w = Rotation.from_matrix(
        rotation_from_angles(*np.radians([roll_deg, pitch_deg, yaw_deg])) @ axes
    ).as_quat()
    return EUROC.format(w, x, y, z)


def test_the_ground_truth_of_euroc_is_read_by_its_own_names_and_axes(tmp_path):
    found = log(tmp_path, upright(3.0, -5.0, 40.0), "euroc")
    assert found.time_s[0] == pytest.approx(1403636580.838555648)
    assert degrees(found.at(found.time_s[0])) == pytest.approx([3.0, -5.0, 40.0])


def test_a_unit_with_other_axes_is_refused_with_the_way_to_name_them(tmp_path):
    with pytest.raises(f.FormatError) as error:
        log(tmp_path, upright(3.0, 5.0, 40.0).replace("1403636580838555648", "1"))
    assert "imu.csv:2: the body lies on its side or back, its up axis" in str(error.value)
    assert "by the convention 'rep103'; if it has other axes, name them: aerospace, euroc (--convention," in str(
        error.value
    )


def test_angles_have_no_meaning_for_a_unit_that_is_built_in_upright(tmp_path):
    with pytest.raises(f.FormatError, match="no meaning for the convention 'euroc'; give a quaternion"):
        log(tmp_path, ANGLES, "euroc")


def test_an_upright_accelerometer_reads_gravity_along_its_x(tmp_path):
    text = "timestamp [ns],ax_mps2,ay_mps2,az_mps2\n0,9.65765,0,-1.70291\n"
    assert degrees(log(tmp_path, text, "euroc").at(0.0)) == pytest.approx([0, 10, 0], abs=1e-3)


def test_camera_and_unit_point_the_same_way_in_any_axes_of_the_unit(tmp_path):
    """The camera of a unit that is built in upright, stated in its axes, as T_BS does."""
    upright_from_body = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    body = Mount(translation_m=(0.2, 0.05, 1.0))
    stated = Mount(upright_from_body @ body.rotation, tuple(upright_from_body @ body.translation_m))
    found = mount_in_flu(stated, "euroc")
    np.testing.assert_allclose(found.rotation, body.rotation, atol=1e-12)
    assert found.translation_m == pytest.approx(body.translation_m)
    front_right_down = Mount(np.diag([1.0, -1.0, -1.0]) @ body.rotation, (0.2, -0.05, -1.0))
    np.testing.assert_allclose(mount_in_flu(front_right_down, "aerospace").rotation, body.rotation, atol=1e-12)
    assert mount_in_flu(front_right_down, "aerospace").translation_m == pytest.approx(body.translation_m)
