"""Kalibr camera chains (`camchain.yaml`, `camchain-imucam.yaml`)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import numbers
from modules.formats.calibration.file import CalibrationFile
from modules.formats.calibration.projections import rigid
from modules.formats.errors import FormatError
from modules.types import Camera, Mount, StereoRig


def read_kalibr(source: str, chain: Mapping[str, object]) -> CalibrationFile:
    """Read cameras 0 and 1 of a chain, `cam0` as the left one.

    With `T_cam_imu` the frame of the inertial measurement unit is taken as the body frame, and the mount follows; it
    has a meaning together with the attitude of that unit only.

    References
    ----------
    P. Furgale, J. Rehder and R. Siegwart, Unified temporal and spatial calibration for multi-sensor systems, IROS 2013.
    """
    if "cam1" not in chain:
        raise FormatError(f"{source} is a Kalibr chain of one camera (cam0) and a stereo pair needs cam0 and cam1")
    left, right = (_mapping(source, name, chain[name]) for name in ("cam0", "cam1"))
    pose = _pose(source, "cam1", right)
    if pose is None:
        raise FormatError(f"{source}: cam1 has no T_cn_cnm1, its pose against cam0; run Kalibr on both cameras at once")
    x, y, z = (float(value) for value in pose[:3, 3])
    rig = StereoRig(_camera(source, "cam0", left), _camera(source, "cam1", right), pose[:3, :3], (x, y, z))
    mount = None
    if "T_cam_imu" in left:
        optical_from_imu = _transform(source, "cam0.T_cam_imu", left["T_cam_imu"])
        turn = optical_from_imu[:3, :3].T
        bx, by, bz = (float(value) for value in -turn @ optical_from_imu[:3, 3])
        mount = Mount(turn, (bx, by, bz))
    return CalibrationFile("Kalibr", rig=rig, mount=mount, body_is_imu=mount is not None)


def _pose(source: str, name: str, camera: Mapping[str, object]) -> NDArray[np.float64] | None:
    if "T_cn_cnm1" not in camera:
        return None
    return _transform(source, f"{name}.T_cn_cnm1", camera["T_cn_cnm1"])


def _camera(source: str, name: str, camera: Mapping[str, object]) -> Camera:
    model, distortion = camera.get("camera_model"), camera.get("distortion_model", "none")
    if model != "pinhole":
        raise FormatError(
            f"{source}: {name} has the camera_model {model!r} and only 'pinhole' can be rectified; "
            "calibrate it with pinhole-equi or pinhole-radtan"
        )
    if distortion not in ("radtan", "equidistant", "none"):
        raise FormatError(
            f"{source}: {name} has the distortion_model {distortion!r}; known are 'radtan', 'equidistant' and 'none'"
        )
    fx, fy, cx, cy = numbers(source, f"{name}.intrinsics", camera.get("intrinsics"), 4)
    width, height = numbers(source, f"{name}.resolution", camera.get("resolution"), 2)
    coefficients: tuple[float, ...] = ()
    if distortion != "none":
        coefficients = tuple(numbers(source, f"{name}.distortion_coeffs", camera.get("distortion_coeffs"), 4))
    return Camera(
        (fx, fy), (cx, cy), round(width), round(height), coefficients,
        "equidistant" if distortion == "equidistant" else "radtan",
    )  # fmt: skip


def _mapping(source: str, name: str, value: object) -> Mapping[str, object]:
    if not isinstance(value, Mapping):
        raise FormatError(f"{source}: {name} is {value!r} and must be a mapping with camera_model and intrinsics")
    return value


def _transform(source: str, name: str, value: object) -> NDArray[np.float64]:
    """Return a rigid transform (4, 4)."""
    if not isinstance(value, list) or len(value) not in (3, 4):
        raise FormatError(f"{source}: {name} is {value!r} and must be 4 rows of 4 numbers")
    rows = [numbers(source, f"{name}[{index}]", row, 4) for index, row in enumerate(value[:3])]
    return rigid(source, name, np.array(rows))
