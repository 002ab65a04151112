"""Calibrations of OpenCV: round trips, and the words of every fault of a rig."""

import cv2
import numpy as np
import pytest
from rigs import RIG, SHAPE, TURN, extrinsics, intrinsics, refused, same_rig, storage

from modules import formats as f


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


@pytest.mark.parametrize("end", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_a_truncated_opencv_file_is_an_error_of_the_file(tmp_path, suffix, end):
    path = storage(tmp_path / f"c{suffix}", **intrinsics(), **extrinsics())
    text = path.read_text()
    path.write_text(text[: int(end * len(text))])
    assert str(path) in refused(path)
