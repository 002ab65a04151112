"""ROS `camera_info` YAML, one file per camera, as camera_calibration writes it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import number, numbers, whole
from modules.formats.calibration.file import CalibrationFile
from modules.formats.calibration.projections import calibration_of, camera_of, rig_of_rectification
from modules.formats.errors import FormatError
from modules.primitives.frames import nearest_rotation, rotation_problem
from modules.types import Camera, Rectification

MODELS = {
    "plumb_bob": "radtan",
    "rational_polynomial": "radtan",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
}


def read_ros(files: list[tuple[str, Mapping[str, object]]]) -> CalibrationFile:
    """Read the two files of a stereo camera: the raw cameras and the rectified pair.

    References
    ----------
    T. Foote and M. Purvis, message sensor_msgs/CameraInfo of ROS: `P` of the right camera holds `Tx = -f B`.
    """
    if len(files) != 2:
        source, mapping = files[0]
        raise FormatError(
            f"{source} is a ROS camera_info of one camera ({mapping.get('camera_name', 'unnamed')}); "
            "give both, left first: --calibration left.yaml --calibration right.yaml"
        )
    (left_name, _), (right_name, _) = files
    cameras = [_camera(name, mapping) for name, mapping in files]
    projections = [_matrix(name, mapping, "projection_matrix", 3, 4) for name, mapping in files]
    if projections[0][0, 3] < 0.0 and projections[1][0, 3] == 0.0:
        raise FormatError(
            f"{left_name} is of the right camera (Tx {projections[0][0, 3]:g}) and {right_name} of the left one; "
            "give the left file first"
        )
    source = f"{left_name} and {right_name}"
    size = (cameras[0].width_px, cameras[0].height_px)
    names = (f"projection_matrix of {left_name}", f"that of {right_name}")
    rectified = calibration_of(source, names, projections[0], projections[1], size)
    rotations = [_rotation(name, mapping) for name, mapping in files]
    rectification = Rectification(rotations[0], rotations[1], rectified)
    return CalibrationFile(
        "ROS camera_info",
        rectified=rectified,
        rig=rig_of_rectification(cameras[0], cameras[1], rectification),
    )


def _camera(source: str, mapping: Mapping[str, object]) -> Camera:
    size = tuple(whole(source, name, number(source, mapping, name)) for name in ("image_width", "image_height"))
    model = str(mapping.get("distortion_model", "plumb_bob") or "plumb_bob")
    if model not in MODELS:
        raise FormatError(f"{source}: the distortion_model is '{model}'; known are {', '.join(sorted(MODELS))}")
    matrix = _matrix(source, mapping, "camera_matrix", 3, 3)
    coefficients: list[float] = []
    if "distortion_coefficients" in mapping:
        block = mapping["distortion_coefficients"]
        data = block.get("data") if isinstance(block, Mapping) else block
        coefficients = numbers(source, "distortion_coefficients", data, len(data) if isinstance(data, list) else 5)
    return camera_of(matrix, coefficients, (size[0], size[1]), equidistant=MODELS[model] == "equidistant")


def _rotation(source: str, mapping: Mapping[str, object]) -> NDArray[np.float64]:
    if "rectification_matrix" not in mapping:
        return np.eye(3)
    matrix = _matrix(source, mapping, "rectification_matrix", 3, 3)
    problem = rotation_problem(matrix)
    if problem:
        raise FormatError(f"{source}: rectification_matrix: {problem}")
    return nearest_rotation(matrix)


def _matrix(source: str, mapping: Mapping[str, object], name: str, rows: int, columns: int) -> NDArray[np.float64]:
    block = mapping.get(name)
    data = block.get("data") if isinstance(block, Mapping) else block
    if data is None:
        raise FormatError(f"{source} has no '{name}' and a ROS camera_info needs it; calibrate the stereo camera again")
    return np.array(numbers(source, name, data, rows * columns)).reshape(rows, columns)
