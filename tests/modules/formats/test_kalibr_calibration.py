"""Camera chains of Kalibr and sensor files of EuRoC: numbers worked by hand, and the words of every fault."""

from pathlib import Path

import numpy as np
import pytest
from rigs import CHAIN, refused

from modules import formats as f
from modules.types import Camera, Mount


@pytest.mark.parametrize("header", ["", "%YAML:1.0\n"])
def test_a_kalibr_chain_with_an_imu_gives_rig_and_mount(tmp_path, header):
    (tmp_path / "camchain-imucam.yaml").write_text(header + CHAIN)
    found = f.read_calibration(tmp_path / "camchain-imucam.yaml")
    assert found.format == "Kalibr"
    assert found.rig.left == Camera((400, 401), (370, 240), 752, 480, (-0.01, 0.02, -0.003, 0.001), "equidistant")
    assert found.rig.right.model == "radtan"
    assert found.rig.translation_m == (-0.11, 0.0, 0.0)
    # T_cam_imu takes (x, y, z) of the IMU to (-y, -z, x) + (0.05, 0, -0.2): it looks along x, from (0.2, 0.05, 0).
    np.testing.assert_allclose(found.mount.rotation, Mount().rotation, atol=1e-12)
    assert found.mount.translation_m == pytest.approx((0.2, 0.05, 0.0))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "camera_model: pinhole\n  distortion_coeffs: [-0.0",
            "camera_model: omni\n  distortion_coeffs: [-0.0",
            "'omni'",
        ),
        ("distortion_model: radtan", "distortion_model: fov", "cam1 has the distortion_model 'fov'"),
        ("cam1:", "cam2:", "is a Kalibr chain of one camera (cam0) and a stereo pair needs cam0 and cam1"),
        ("T_cn_cnm1:", "T_other:", "cam1 has no T_cn_cnm1, its pose against cam0; run Kalibr on both cameras at once"),
        ("[752, 480]\n  T_cam", "[752]\n  T_cam", "cam0.resolution is [752] and must be a list of 2 numbers"),
        ("[1.0, 0.0, 0.0, -0.11]", "[1.0, 0.1, 0.0, -0.11]", "the rotation of cam1.T_cn_cnm1: it is no rotation"),
    ],
)
def test_faults_of_a_kalibr_chain_are_named(tmp_path, old, new, words):
    assert old in CHAIN
    (tmp_path / "c.yaml").write_text(CHAIN.replace(old, new, 1))
    assert words in refused(tmp_path / "c.yaml")


SENSOR = """
%YAML:1.0
# General sensor definitions.
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0.0, 0.0, 1.0, 0.2,
         -1.0, 0.0, 0.0, {y},
         0.0, -1.0, 0.0, 1.0,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [{f}, 457.0, 367.0, 248.0] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]
""".lstrip()


def sensors(folder: Path, old: str = "", new: str = "") -> list[Path]:
    """Write `sensor.yaml` of two cameras that look along x of the body, 0.11 m apart, the right one changed."""
    paths = [folder / name / "sensor.yaml" for name in ("cam0", "cam1")]
    for path, y, f_px in zip(paths, (0.05, -0.06), (458.0, 459.0), strict=True):
        path.parent.mkdir()
        path.write_text(SENSOR.format(y=y, f=f_px))
    assert old in paths[1].read_text()
    paths[1].write_text(paths[1].read_text().replace(old, new, 1))
    return paths


def test_the_sensor_files_of_euroc_cameras_give_rig_and_mount(tmp_path):
    found = f.read_calibration(sensors(tmp_path))
    assert found.format == "EuRoC"
    assert found.rig.left == Camera((458, 457), (367, 248), 752, 480, (-0.28, 0.07, 0.0002, 0.00002))
    assert found.rig.right.focal_px == (459, 457)
    # The right camera is 0.11 m to the right of the left one, so a point is 0.11 m more to the left for it.
    np.testing.assert_allclose(found.rig.rotation, np.eye(3), atol=1e-12)
    assert found.rig.translation_m == pytest.approx((-0.11, 0.0, 0.0))
    np.testing.assert_allclose(found.mount.rotation, Mount().rotation, atol=1e-12)
    assert found.mount.translation_m == pytest.approx((0.2, 0.05, 1.0))
    assert found.body_is_imu


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "camera_model: pinhole",
            "camera_model: omni",
            "the camera_model is 'omni' and only 'pinhole' can be rectified",
        ),
        ("radial-tangential", "fov", "'fov'; known are radial-tangential, radtan, equidistant"),
        ("[-0.28, 0.07, 0.0002, 0.00002]", "[-0.28]", "distortion_coefficients is [-0.28] and must be a list of 4"),
        ("[752, 480]", "[752.5, 480]", "resolution is 752.5 and must be a whole number of px"),
        ("[0.0, 0.0, 1.0, 0.2,", "[0.0, 0.1, 1.0, 0.2,", "the rotation of T_BS: it is no rotation"),
        ("         0.0, 0.0, 0.0, 1.0]", "         1.0]", "must be a list of 16 numbers"),
        ("T_BS", "T_SB", "are not two files of one calibration; two are taken for OpenCV"),
    ],
)
def test_faults_of_euroc_sensors_are_named(tmp_path, old, new, words):
    assert words in refused(sensors(tmp_path, old, new))


def test_one_euroc_sensor_is_not_enough_and_the_left_one_comes_first(tmp_path):
    left, right = sensors(tmp_path)
    assert refused(left) == (
        f"{left} is a EuRoC sensor.yaml of one camera; "
        "give both, left first: --calibration cam0/sensor.yaml --calibration cam1/sensor.yaml"
    )
    assert "the baseline is -0.11 m and must be above 0; swap the images" in refused([right, left])
