"""Calibrations of every format: numbers worked by hand, round trips, and the words of every fault."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from modules import formats as f
from modules.formats.calibration import calibration_schema
from modules.primitives.frames import rotation_from_angles
from modules.types import Calibration, Camera, Mount, StereoRig

# Right camera 0.12 m to the right of the left one, turned by 1 degree about its row axis.
TURN = cv2.Rodrigues(np.array([0.0, np.radians(1.0), 0.0]))[0]
RIG = StereoRig(
    Camera((500.0, 501.0), (319.0, 239.0), 640, 480, (-0.3, 0.1, 0.001, -0.002, 0.0)),
    Camera((502.0, 503.0), (321.0, 241.0), 640, 480, (-0.29, 0.09, 0.0, 0.0, 0.01)),
    TURN,
    (-0.12, 0.001, 0.002),
)
SHAPE = (480, 640)


def storage(path: Path, **nodes: object) -> Path:
    """Write an OpenCV storage file; the suffix decides between YAML and XML."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in nodes.items():
        file.write(name, value)
    file.release()
    return path


def intrinsics(rig: StereoRig = RIG) -> dict[str, np.ndarray]:
    distortions = {f"D{i}": np.array([c.distortion]) for i, c in ((1, rig.left), (2, rig.right))}
    return {"M1": rig.left.matrix, "M2": rig.right.matrix, **distortions}


def extrinsics(rig: StereoRig = RIG) -> dict[str, np.ndarray]:
    return {"R": rig.rotation, "T": np.array([rig.translation_m]).T}


def same_rig(found: StereoRig, rig: StereoRig = RIG, tolerance: float = 1e-12) -> None:
    for a, b in ((found.left, rig.left), (found.right, rig.right)):
        np.testing.assert_allclose((*a.focal_px, *a.centre_px), (*b.focal_px, *b.centre_px), rtol=tolerance)
        np.testing.assert_allclose(a.distortion, b.distortion, rtol=tolerance)
        assert (a.model, a.width_px, a.height_px) == (b.model, b.width_px, b.height_px)
    np.testing.assert_allclose(found.rotation, rig.rotation, atol=tolerance)
    np.testing.assert_allclose(found.translation_m, rig.translation_m, atol=tolerance)


@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_opencv_intrinsics_and_extrinsics_are_read_together(tmp_path, suffix):
    files = [
        storage(tmp_path / f"intrinsics{suffix}", **intrinsics()),
        storage(tmp_path / f"extrinsics{suffix}", **extrinsics()),
    ]
    found = f.read_calibration(files, SHAPE)
    assert found.format == "OpenCV"
    same_rig(found.rig)
    assert found.rig.rectification is None
    assert found.rectified is None


def test_one_opencv_file_holds_the_rig_and_its_rectification(tmp_path):
    size = (640, 480)
    r1, r2, p1, p2, q = cv2.stereoRectify(
        RIG.left.matrix, np.array(RIG.left.distortion), RIG.right.matrix, np.array(RIG.right.distortion), size,
        RIG.rotation, np.array(RIG.translation_m).reshape(3, 1), alpha=0,
    )[:5]  # fmt: skip
    path = storage(tmp_path / "stereo.yml", **intrinsics(), **extrinsics(), R1=r1, R2=r2, P1=p1, P2=p2, Q=q)
    found = f.read_calibration(path, SHAPE)
    same_rig(found.rig)
    np.testing.assert_allclose(found.rig.rectification.left_rotation, r1, atol=1e-12)
    np.testing.assert_allclose(found.rig.rectification.right_rotation, r2, atol=1e-12)
    rectified = found.rectified
    assert rectified.baseline_m == pytest.approx(np.linalg.norm(RIG.translation_m), abs=1e-9)
    assert (rectified.focal_px, rectified.cx_px, rectified.cy_px) == pytest.approx((p1[0, 0], p1[0, 2], p1[1, 2]))
    assert rectified.doffs_px == pytest.approx(0.0, abs=1e-9)


def test_the_size_stated_in_an_opencv_file_wins_over_the_images(tmp_path):
    path = storage(tmp_path / "c.yml", image_width=640, image_height=480, **intrinsics(), **extrinsics())
    assert f.read_calibration(path, (240, 320)).rig.left.width_px == 640


def test_a_rotation_vector_will_do(tmp_path):
    path = storage(tmp_path / "c.yml", **intrinsics(), R=cv2.Rodrigues(TURN)[0], T=np.array(RIG.translation_m))
    same_rig(f.read_calibration(path, SHAPE).rig)


def camera_info(path: Path, camera: Camera, rotation: np.ndarray, projection: np.ndarray, model="plumb_bob") -> Path:
    def block(matrix: np.ndarray) -> dict[str, object]:
        rows, columns = np.atleast_2d(matrix).shape
        return {"rows": rows, "cols": columns, "data": [float(value) for value in np.ravel(matrix)]}

    content = {
        "image_width": camera.width_px,
        "image_height": camera.height_px,
        "camera_name": path.stem,
        "camera_matrix": block(camera.matrix),
        "distortion_model": model,
        "distortion_coefficients": block(np.array(camera.distortion)),
        "rectification_matrix": block(rotation),
        "projection_matrix": block(projection),
    }
    path.write_text(yaml.safe_dump(content))
    return path


def ros_files(folder: Path, **changes: object) -> list[Path]:
    r1, r2, p1, p2 = cv2.stereoRectify(
        RIG.left.matrix, np.array(RIG.left.distortion), RIG.right.matrix, np.array(RIG.right.distortion), (640, 480),
        RIG.rotation, np.array(RIG.translation_m).reshape(3, 1), alpha=0,
    )[:4]  # fmt: skip
    return [
        camera_info(folder / "left.yaml", RIG.left, r1, p1, **changes),
        camera_info(folder / "right.yaml", RIG.right, r2, p2, **changes),
    ]


def test_the_two_files_of_a_ros_camera_give_the_rig_back(tmp_path):
    """The pose of the cameras is not in these files; it follows from the rectification."""
    found = f.read_calibration(ros_files(tmp_path))
    assert found.format == "ROS camera_info"
    same_rig(found.rig, tolerance=1e-9)
    assert found.rectified.baseline_m == pytest.approx(np.linalg.norm(RIG.translation_m), abs=1e-9)


CHAIN = """
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.02, -0.003, 0.001]
  distortion_model: equidistant
  intrinsics: [400.0, 401.0, 370.0, 240.0]
  resolution: [752, 480]
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.05]
  - [0.0, 0.0, -1.0, 0.0]
  - [1.0, 0.0, 0.0, -0.2]
  - [0.0, 0.0, 0.0, 1.0]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.3, 0.1, 0.001, 0.0]
  distortion_model: radtan
  intrinsics: [402.0, 402.0, 372.0, 241.0]
  resolution: [752, 480]
"""


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


KITTI = (
    "P0: 7.0e2 0 6.0e2 0 0 7.0e2 1.8e2 0 0 0 1 0\nP1: 7.0e2 0 6.0e2 -3.5e2 0 7.0e2 1.8e2 0 0 0 1 0\n"
    "P2: 7.0e2 0 6.0e2 4.2e1 0 7.0e2 1.8e2 2e-1 0 0 1 2e-3\nP3: 7.0e2 0 6.0e2 -3.08e2 0 7.0e2 1.8e2 2 0 0 1 3e-3\n"
    "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n"
)


@pytest.mark.parametrize(("shape", "baseline"), [((370, 1226), 0.5), ((370, 1226, 3), 0.5), (None, None)])
def test_kitti_takes_the_gray_or_the_colour_pair(tmp_path, shape, baseline):
    (tmp_path / "calib.txt").write_text(KITTI.replace("-3.08e2", "-3.29e2") if shape == (370, 1226, 3) else KITTI)
    if shape is None:
        with pytest.raises(f.FormatError, match="does not hold the size of the images"):
            f.read_calibration(tmp_path / "calib.txt")
        return
    found = f.read_calibration(tmp_path / "calib.txt", shape)
    # Gray: 350 / 700; colour: (42 + 329) / 700.
    expected = 0.5 if len(shape) == 2 else 0.53
    assert found.rectified == Calibration(700.0, 600.0, 180.0, pytest.approx(expected), 1226, 370)


def test_kitti_raw_holds_the_size(tmp_path):
    rows = "".join(line.replace("P", "P_rect_0", 1) + "\n" for line in KITTI.splitlines() if line.startswith("P"))
    (tmp_path / "cam_to_cam.txt").write_text("calib_time: 09-Jan-2012 13:57:47\nS_rect_00: 1242 375\n" + rows)
    assert f.read_calibration(tmp_path / "cam_to_cam.txt").rectified.width_px == 1242


def test_a_rig_survives_the_own_form_exactly(tmp_path):
    mount = Mount(rotation_from_angles(0.1, 0.3, -0.2) @ Mount().rotation, (0.3, 0.0, 1.1))
    f.write_calibration(tmp_path / "c.yaml", RIG, mount)
    found = f.read_calibration(tmp_path / "c.yaml")
    same_rig(found.rig, tolerance=0.0)
    np.testing.assert_array_equal(found.mount.rotation, mount.rotation)


def test_a_mount_in_aerospace_axes_is_turned(tmp_path):
    """In a front-right-down body, 0.9 m above the origin is z = -0.9; looking ahead is z_optical along x."""
    text = (
        "focal_px: 500\ncx_px: 320\ncy_px: 240\nbaseline_m: 0.09\nwidth_px: 640\nheight_px: 480\nmount:\n"
        "  convention: aerospace\n  rotation_matrix: [[0, 0, 1], [1, 0, 0], [0, 1, 0]]\n"
        "  translation_m: [0.1, 0.2, -0.9]\n"
    )
    (tmp_path / "c.yaml").write_text(text)
    mount = f.read_calibration(tmp_path / "c.yaml").mount
    np.testing.assert_array_equal(mount.rotation, Mount().rotation)
    assert mount.translation_m == (0.1, -0.2, 0.9)


def test_the_published_schema_is_current_and_accepts_what_is_written(tmp_path):
    published = json.loads(Path("docs/calibration.schema.json").read_text(encoding="utf-8"))
    assert published == calibration_schema(), "renew it: terrex calibrate --schema > docs/calibration.schema.json"


# Faults


def refused(paths: Path | list[Path], shape=SHAPE) -> str:
    with pytest.raises(f.FormatError) as error:
        f.read_calibration(paths, shape)
    return str(error.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"T": np.array([0.12, 0, 0])},
            "the baseline is -0.12 m and must be above 0; swap the images if it is negative",
        ),
        ({"T": np.array([-120.0, 0, 0])}, "the baseline is 120 m, above 20 m; is it in mm? divide by 1000"),
        ({"T": np.array([-1e-5, 0, 0])}, "the baseline is 1e-05 m, below 0.001 m; give it in m"),
        (
            {"T": np.array([0, -0.12, 0]), "R": np.eye(3)},
            "the right camera stands at (0, 0.12, 0) m of the left one, above or below it and not beside it; "
            "turn the images of an upright rig by 90 degrees, with its calibration",
        ),
        (
            {"M1": np.diag([6.0, 6.0, 1.0])},
            "the focal length of the left camera is 6 px, below 64 px for a width of 640 px; "
            "is it in mm? divide by the pixel pitch in mm",
        ),
        (
            {"M2": np.array([[500.0, 0, 2000], [0, 500, 240], [0, 0, 1]])},
            "the principal point of the right camera is (2000, 240) px, far outside the image of 640x480 px; "
            "the calibration is for another size of image or its numbers are in another order",
        ),
        ({"R": np.diag([1.0, 1.0, -1.0])}, "R: it is left-handed (determinant -1, must be +1): it mirrors; "),
        ({"R": np.eye(3) * 2}, "R: it is no rotation (R R^T differs from 1 by 3, limit 0.001); "),
        (
            {"R": cv2.Rodrigues(np.array([0.0, 0.0, 1.5]))[0]},
            "the cameras are turned by 86 deg against each other, above 60 deg; ",
        ),
        ({"D1": np.zeros((1, 3)) + 0.1}, "the left camera has 3 distortion coefficients and the model 'radtan' takes "),
        ({"M1": np.full((3, 3), np.nan)}, "M1 holds NaN or infinite numbers; calibrate again"),
    ],
)
def test_a_rig_that_cannot_be_is_refused(tmp_path, changes, words):
    path = storage(tmp_path / "c.yml", **{**intrinsics(), **extrinsics(), **changes})
    assert words in refused(path)
    assert refused(path).startswith(f"{path}")


def test_all_faults_of_a_rig_are_reported_at_once(tmp_path):
    changes = {"M1": np.diag([6.0, 6.0, 1.0]), "T": np.array([0.12, 0, 0])}
    said = refused(storage(tmp_path / "c.yml", **{**intrinsics(), **extrinsics(), **changes}))
    assert "is it in mm" in said
    assert "swap the images" in said


def test_intrinsics_alone_name_what_is_missing(tmp_path):
    path = storage(tmp_path / "intrinsics.yml", **intrinsics())
    assert refused(path) == (
        f"{path} has D1, D2, M1, M2 and lacks R, T, or else P1 and P2 of a rectified pair; give intrinsics and "
        "extrinsics together: --calibration intrinsics.yml --calibration extrinsics.yml"
    )


def test_a_calibration_of_one_camera_is_named(tmp_path):
    path = storage(tmp_path / "c.yml", camera_matrix=np.eye(3), distortion_coefficients=np.zeros(5))
    assert "it is of one camera: calibrate the pair, e.g. with terrex calibrate" in refused(path)


def test_files_that_do_not_belong_together_are_named(tmp_path):
    one = storage(tmp_path / "intrinsics.yml", **intrinsics())
    other = storage(tmp_path / "extrinsics.yml", **extrinsics(), M1=np.eye(3))
    assert refused([one, other]) == f"{one} and {other} hold different values of M1; give the files of one calibration"
    (tmp_path / "k.yaml").write_text(CHAIN)
    assert "are not two files of one calibration" in refused([one, tmp_path / "k.yaml"])
    assert refused([one, one, one]) == "3 calibration files were given; give one, or two that belong together"


def test_ros_files_in_the_wrong_order_or_number_are_named(tmp_path):
    left, right = ros_files(tmp_path)
    assert "give the left file first" in refused([right, left])
    assert refused(left) == (
        f"{left} is a ROS camera_info of one camera (left); "
        "give both, left first: --calibration left.yaml --calibration right.yaml"
    )


def test_an_unknown_distortion_model_is_named(tmp_path):
    paths = ros_files(tmp_path, model="thin_prism")
    assert refused(paths).endswith(
        "the distortion_model is 'thin_prism'; known are equidistant, fisheye, plumb_bob, rational_polynomial"
    )


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


def test_projections_of_two_pairs_are_refused(tmp_path):
    (tmp_path / "calib.txt").write_text(KITTI.replace("P1: 7.0e2", "P1: 7.1e2"))
    assert refused(tmp_path / "calib.txt") == (
        f"{tmp_path / 'calib.txt'}: P0 has f 700 and 700, cy 180 and P1 has f 710, cy 180 px; "
        "the two of a rectified pair have one focal length and one cy: these are of different pairs"
    )


def test_forgotten_doffs_are_noticed_where_the_second_camera_is_known(tmp_path):
    (tmp_path / "calib.txt").write_text(
        "cam0=[935 0 148; 0 935 138; 0 0 1]\ncam1=[935 0 198; 0 935 138; 0 0 1]\ndoffs=0\nbaseline=160\nwidth=347\n"
        "height=277\n"
    )
    assert refused(tmp_path / "calib.txt") == (
        f"{tmp_path / 'calib.txt'}: doffs is 0 px and cx of cam1 minus cx of cam0 is 50 px; they must agree, "
        "or depths are wrong and far points come to lie behind the camera: correct doffs"
    )


def test_a_file_that_is_no_calibration_says_what_was_found(tmp_path):
    (tmp_path / "c.yaml").write_text("roll_deg: 3\npitch_deg: 4\n")
    assert refused(tmp_path / "c.yaml").startswith(
        f"{tmp_path / 'c.yaml'} has the fields roll_deg, pitch_deg and is no calibration that terrex knows; known are "
    )


@pytest.mark.parametrize("end", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_a_truncated_opencv_file_is_an_error_of_the_file(tmp_path, suffix, end):
    path = storage(tmp_path / f"c{suffix}", **intrinsics(), **extrinsics())
    text = path.read_text()
    path.write_text(text[: int(end * len(text))])
    assert str(path) in refused(path)


def test_faults_inside_the_blocks_of_the_own_form_are_named(tmp_path):
    f.write_calibration(tmp_path / "c.yaml", RIG)
    stated = yaml.safe_load((tmp_path / "c.yaml").read_text())
    stated["left"]["focal"] = stated["left"].pop("focal_px")
    stated["right"]["model"] = "fov"
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(stated))
    said = refused(tmp_path / "c.yaml")
    assert "left has unknown field 'focal'; did you mean 'focal_px'?" in said
    assert "has no 'left.focal_px'; add a line 'left.focal_px: value'" in said
    assert "right.model is 'fov': input should be 'radtan' or 'equidistant'" in said


def test_a_calibration_is_scaled_only_when_asked_and_the_aspect_fits(tmp_path):
    found = f.CalibrationFile("terrex", rectified=Calibration(500, 319.5, 239.5, 0.1, 640, 480, 10.0), rig=RIG)
    with pytest.raises(f.FormatError, match=r"the aspect fits a scale of 0\.5: .* ask for it with --scale-calibration"):
        f.for_images(found, (240, 320))
    half = f.for_images(found, (240, 320), scale=True)
    # The centre of the image stays its centre: 319.5 of 640 columns is 159.5 of 320.
    assert half.rectified == Calibration(250.0, 159.5, 119.5, 0.1, 320, 240, 5.0)
    assert half.rig.left.focal_px == (250.0, 250.5)
    assert half.rig.left.distortion == RIG.left.distortion
    with pytest.raises(f.FormatError, match="its aspect differs, so it cannot be scaled: use the calibration of these"):
        f.for_images(found, (400, 640), scale=True)
