"""The `sensor.yaml` of the cameras of a EuRoC sequence (`mav0/cam0`, `mav0/cam1`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from modules.formats._text import numbers, whole
from modules.formats.calibration.file import CalibrationFile
from modules.formats.calibration.projections import Matrix, camera_of, rigid
from modules.formats.errors import FormatError
from modules.types import Camera, Mount, StereoRig

MODELS = ("radial-tangential", "radtan", "equidistant")
KEY = "T_BS"


def read_euroc(files: Sequence[tuple[str, Mapping[str, object]]]) -> CalibrationFile:
    """Read the files of the left and the right camera.

    `T_BS` takes points of the camera to the body. The body of such sequences is the inertial unit, so that the mount
    that follows has a meaning together with the attitude of that unit only.

    References
    ----------
    M. Burri et al., The EuRoC micro aerial vehicle datasets, International Journal of Robotics Research, 2016.
    """
    if len(files) != 2:
        raise FormatError(
            f"{files[0][0]} is a EuRoC sensor.yaml of one camera; "
            "give both, left first: --calibration cam0/sensor.yaml --calibration cam1/sensor.yaml"
        )
    (left_name, left), (right_name, right) = files
    body_from_left, body_from_right = _pose(left_name, left), _pose(right_name, right)
    right_from_left = np.linalg.inv(body_from_right) @ body_from_left
    x, y, z = (float(value) for value in right_from_left[:3, 3])
    rig = StereoRig(_camera(left_name, left), _camera(right_name, right), right_from_left[:3, :3], (x, y, z))
    bx, by, bz = (float(value) for value in body_from_left[:3, 3])
    return CalibrationFile("EuRoC", rig=rig, mount=Mount(body_from_left[:3, :3], (bx, by, bz)), body_is_imu=True)


def _pose(source: str, sensor: Mapping[str, object]) -> Matrix:
    stated = sensor[KEY]
    data = numbers(source, f"{KEY}.data", stated.get("data") if isinstance(stated, Mapping) else stated, 16)
    return rigid(source, KEY, np.array(data).reshape(4, 4))


def _camera(source: str, sensor: Mapping[str, object]) -> Camera:
    model, distortion = sensor.get("camera_model"), sensor.get("distortion_model")
    if model != "pinhole":
        raise FormatError(f"{source}: the camera_model is {model!r} and only 'pinhole' can be rectified")
    if distortion not in MODELS:
        raise FormatError(f"{source}: the distortion_model is {distortion!r}; known are {', '.join(MODELS)}")
    fx, fy, cx, cy = numbers(source, "intrinsics", sensor.get("intrinsics"), 4)
    size = numbers(source, "resolution", sensor.get("resolution"), 2)
    width, height = (whole(source, "resolution", value) for value in size)
    coefficients = numbers(source, "distortion_coefficients", sensor.get("distortion_coefficients"), 4)
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return camera_of(matrix, coefficients, (width, height), equidistant=distortion == "equidistant")
