"""The `camera_info` files of ROS."""

import numpy as np
import pytest
from rigs import RIG, refused, ros_files, same_rig

from modules import formats as f


def test_the_two_files_of_a_ros_camera_give_the_rig_back(tmp_path):
    """The pose of the cameras is not in these files; it follows from the rectification."""
    found = f.read_calibration(ros_files(tmp_path))
    assert found.format == "ROS camera_info"
    same_rig(found.rig, tolerance=1e-9)
    assert found.rectified.baseline_m == pytest.approx(np.linalg.norm(RIG.translation_m), abs=1e-9)


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
