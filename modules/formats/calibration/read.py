"""Calibration files of every known format, told apart by their content."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, TypeAlias

import yaml

from modules.formats._text import as_mapping, parse_yaml, read_text, write_text
from modules.formats.calibration.euroc import KEY as EUROC_KEY
from modules.formats.calibration.euroc import read_euroc
from modules.formats.calibration.file import CalibrationFile
from modules.formats.calibration.kalibr import read_kalibr
from modules.formats.calibration.kitti import LINE as KITTI_LINE
from modules.formats.calibration.kitti import read_kitti
from modules.formats.calibration.middlebury import read_middlebury
from modules.formats.calibration.opencv import is_opencv, read_opencv
from modules.formats.calibration.own import FIELDS, as_own, read_own
from modules.formats.calibration.plausible import checked
from modules.formats.calibration.ros import read_ros
from modules.formats.errors import FormatError
from modules.types import Calibration, Camera, Mount, StereoRig

MIDDLEBURY = re.compile(r"^\s*cam0\s*=", re.MULTILINE)
ROS_KEYS = ("camera_matrix", "projection_matrix")
KNOWN = (
    "terrex YAML (focal_px, ... or left, right, right_from_left), OpenCV stereo_calib (M1, D1, M2, D2, R, T), "
    "ROS camera_info (camera_matrix, projection_matrix), Kalibr camchain (cam0, cam1), EuRoC sensor.yaml (T_BS), "
    "KITTI (P0, P1) and Middlebury (cam0=, baseline=)"
)
SAME_ASPECT = 0.01

CalibrationSource: TypeAlias = str | Path | Sequence[str | Path]


def read_calibration(paths: CalibrationSource, image_shape: tuple[int, ...] | None = None) -> CalibrationFile:
    """Read a calibration in any known format.

    Parameters
    ----------
    paths : path or sequence of paths
        One file: terrex YAML, OpenCV YAML or XML, Kalibr camchain, KITTI `calib.txt`, Middlebury `calib.txt`. Two:
        OpenCV intrinsics and extrinsics, or ROS `camera_info` or EuRoC `sensor.yaml` of the left and the right camera,
        in this order.
    image_shape : tuple of int, optional
        Shape of the images, needed by formats that do not hold their size (OpenCV, KITTI).

    Returns
    -------
    CalibrationFile

    Raises
    ------
    FormatError
        For a missing or malformed file, an unknown format, and values that cannot be: baseline not positive or in mm,
        focal length not positive or in mm, a matrix that is no rotation, cameras not beside each other.
    """
    names = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    if not 1 <= len(names) <= 2:
        raise FormatError(f"{len(names)} calibration files were given; give one, or two that belong together")
    files = [(str(path), read_text(path, "calibration")) for path in names]
    source = " and ".join(name for name, _ in files)
    kinds = {_kind(text) for _, text in files}
    if kinds == {"opencv"}:
        return checked(source, read_opencv(files, image_shape), unit_stated=False)
    mappings = [(name, _mapping(name, text)) for name, text in files] if kinds == {"yaml"} else []
    if mappings and all(any(key in mapping for key in ROS_KEYS) for _, mapping in mappings):
        return checked(source, read_ros(mappings), unit_stated=False)
    if mappings and all(EUROC_KEY in mapping for _, mapping in mappings):
        return checked(source, read_euroc(mappings), unit_stated=False)
    if len(files) > 1:
        raise FormatError(
            f"{source} are not two files of one calibration; two are taken for OpenCV (intrinsics and extrinsics), "
            "for ROS camera_info and for EuRoC sensor.yaml (left and right)"
        )
    return _read_one(source, files[0][1], [mapping for _, mapping in mappings], image_shape)


def _read_one(
    source: str, text: str, mappings: list[Mapping[str, object]], image_shape: tuple[int, ...] | None
) -> CalibrationFile:
    if MIDDLEBURY.search(text):
        return checked(source, read_middlebury(source, text), unit_stated=True)
    if not mappings:
        return checked(source, read_kitti(source, text, image_shape), unit_stated=False)
    mapping = mappings[0]
    if "cam0" in mapping:
        return checked(source, read_kalibr(source, mapping), unit_stated=False)
    if FIELDS & set(mapping):
        return checked(source, read_own(source, mapping), unit_stated=True)
    found = ", ".join(str(key) for key in list(mapping)[:6])
    raise FormatError(f"{source} has the fields {found} and is no calibration that terrex knows; known are {KNOWN}")


def _kind(text: str) -> Literal["opencv", "table", "yaml"]:
    if is_opencv(text):
        return "opencv"
    return "table" if MIDDLEBURY.search(text) or KITTI_LINE.search(text) else "yaml"


def _mapping(name: str, text: str) -> Mapping[str, object]:
    return as_mapping(name, parse_yaml(name, text), "calibration")


def write_calibration(path: Path | str, geometry: Calibration | StereoRig, mount: Mount | None = None) -> None:
    """Write a rectified pair or a rig, and the mount if given, as YAML that `read_calibration` reads back exactly."""
    write_text(Path(path), yaml.safe_dump(as_own(geometry, mount), sort_keys=False, default_flow_style=None))


def for_images(found: CalibrationFile, shape: tuple[int, ...], *, scale: bool = False) -> CalibrationFile:
    """Return the calibration for images of `shape` (rows, columns, ...).

    Parameters
    ----------
    found : CalibrationFile
    shape : tuple of int
    scale : bool
        Scale a calibration of another size whose aspect fits.

    Raises
    ------
    FormatError
        When the sizes differ; the message offers the scale if one explains the difference.
    """
    geometry = found.rectified or (found.rig.left if found.rig is not None else None)
    if geometry is None or (geometry.height_px, geometry.width_px) == tuple(shape[:2]):
        return found
    factor = _scale(geometry, shape, allowed=scale)
    rectified, rig = found.rectified, found.rig
    if rectified is not None:
        rectified = scaled(rectified, factor, shape)
    if rig is not None:
        plan = rig.rectification
        if plan is not None:
            plan = replace(plan, calibration=scaled(plan.calibration, factor, shape))
        left, right = _scaled_camera(rig.left, factor, shape), _scaled_camera(rig.right, factor, shape)
        rig = replace(rig, left=left, right=right, rectification=plan)
    return replace(found, rectified=rectified, rig=rig)


def check_calibration(calibration: Calibration, shape: tuple[int, int]) -> None:
    """Check that a calibration can be, and was made for images of `shape` (rows, columns).

    Raises
    ------
    FormatError
        For impossible values, and when the sizes differ, with the scale if one explains the difference.
    """
    checked("the calibration", CalibrationFile("Python", rectified=calibration), unit_stated=True)
    if (calibration.height_px, calibration.width_px) != shape:
        _scale(calibration, shape, allowed=False)


def scaled(calibration: Calibration, factor: float, shape: tuple[int, ...]) -> Calibration:
    """Return the calibration of images resampled by `factor` to `shape`."""
    return Calibration(
        focal_px=calibration.focal_px * factor,
        cx_px=_scaled_centre(calibration.cx_px, factor),
        cy_px=_scaled_centre(calibration.cy_px, factor),
        baseline_m=calibration.baseline_m,
        width_px=shape[1],
        height_px=shape[0],
        doffs_px=calibration.doffs_px * factor,
    )


def _scaled_camera(camera: Camera, factor: float, shape: tuple[int, ...]) -> Camera:
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    return replace(
        camera,
        focal_px=(fx * factor, fy * factor),
        centre_px=(_scaled_centre(cx, factor), _scaled_centre(cy, factor)),
        width_px=shape[1],
        height_px=shape[0],
    )


def _scaled_centre(centre_px: float, factor: float) -> float:
    return (centre_px + 0.5) * factor - 0.5  # pixel centres have whole coordinates


def _scale(geometry: Calibration | Camera, shape: tuple[int, ...], *, allowed: bool) -> float:
    rows, columns = shape[:2]
    scale_x, scale_y = columns / geometry.width_px, rows / geometry.height_px
    fits = abs(scale_x / scale_y - 1.0) < SAME_ASPECT
    if fits and allowed:
        return (scale_x + scale_y) / 2.0
    remedy = "its aspect differs, so it cannot be scaled: use the calibration of these images"
    if fits:
        remedy = (
            f"the aspect fits a scale of {scale_x:.3g}: if these are the whole images resampled, "
            "ask for it with --scale-calibration"
        )
    raise FormatError(
        f"the calibration is for {geometry.width_px}x{geometry.height_px} px and the images are "
        f"{columns}x{rows} px; {remedy}"
    )
