"""Calibrations of KITTI and of the own form, and what is told of files of any format."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from rigs import CHAIN, RIG, extrinsics, intrinsics, refused, same_rig, storage

from modules import formats as f
from modules.formats.calibration import calibration_schema
from modules.primitives.frames import rotation_from_angles
from modules.types import Calibration, Mount

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
