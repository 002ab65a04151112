"""OpenCV's own files, YAML or XML, as its example `stereo_calib` writes them."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.formats.calibration.file import CalibrationFile
from modules.formats.calibration.projections import calibration_of, camera_of, shape_3x3, shape_3x4
from modules.formats.errors import FormatError
from modules.primitives.frames import nearest_rotation, rotation_problem
from modules.types import Calibration, Rectification, StereoRig

# The names of `stereo_calib`, and those that others use for the same.
NAMES = {
    "M1": ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "camera_matrix_left"),
    "M2": ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "camera_matrix_right"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "distortion_left"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "distortion_right"),
    **{name: (name,) for name in ("R", "T", "R1", "R2", "P1", "P2", "Q")},
}
WIDTHS, HEIGHTS = ("image_width", "width", "imageWidth"), ("image_height", "height", "imageHeight")
SIZES = ("imageSize", "image_size", "size")
Nodes = Mapping[str, NDArray[np.float64]]


def is_opencv(text: str) -> bool:
    """Tell whether a text is one of OpenCV's storage files."""
    return "<opencv_storage" in text or "!!opencv-matrix" in text


def read_opencv(files: list[tuple[str, str]], image_shape: tuple[int, ...] | None) -> CalibrationFile:
    """Read `intrinsics.yml` and `extrinsics.yml`, or one file with both.

    With M1, D1, M2, D2, R and T the cameras as they are; with P1 and P2 the rectified pair; with R1 and R2 how the one
    comes from the other. A `fisheye: 1` says that D1 and D2 are of OpenCV's fisheye model. The unit of T is not stated
    in such files: it must be the metre.

    Parameters
    ----------
    files : list of (name, text)
    image_shape : tuple of int, optional
        Shape of the images: `stereo_calib` does not write it.
    """
    source = " and ".join(name for name, _ in files)
    nodes: dict[str, NDArray[np.float64]] = {}
    for name, text in files:
        for key, value in _nodes(name, text).items():
            if key in nodes and not np.array_equal(nodes[key], value):
                raise FormatError(f"{source} hold different values of {key}; give the files of one calibration")
            nodes[key] = value
    size = _size(source, nodes, image_shape)
    known = {short: nodes[name] for short, names in NAMES.items() for name in names if name in nodes}
    rectified = _rectified(source, known, size)
    rig = _rig(source, known, size, rectified, fisheye=bool(np.any(nodes.get("fisheye", 0.0))))
    if rectified is None and rig is None:
        missing = [name for name in ("M1", "D1", "M2", "D2", "R", "T") if name not in known]
        remedy = "give intrinsics and extrinsics together: --calibration intrinsics.yml --calibration extrinsics.yml"
        if "camera_matrix" in nodes:
            remedy = "it is of one camera: calibrate the pair, e.g. with terrex calibrate"
        raise FormatError(
            f"{source} has {', '.join(sorted(nodes)) or 'no numbers'} and lacks {', '.join(missing)}, "
            f"or else P1 and P2 of a rectified pair; {remedy}"
        )
    return CalibrationFile("OpenCV", rectified=rectified, rig=rig)


def _nodes(source: str, text: str) -> dict[str, NDArray[np.float64]]:
    """Return all numbers and matrices of a storage file by name."""
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (cv2.error, SystemError) as error:  # the constructor wraps OpenCV's error into a SystemError
        raise FormatError(f"{source} is not readable by OpenCV ({_reason(error)}); write it again") from error
    found: dict[str, NDArray[np.float64]] = {}
    try:
        root = storage.root()
        for key in root.keys():  # noqa: SIM118 - a FileNode is no mapping
            node = root.getNode(key)
            value = _numbers(node)
            if value is not None:
                if not np.isfinite(value).all():
                    raise FormatError(f"{source}: {key} holds NaN or infinite numbers; calibrate again")
                found[key] = value
    except cv2.error as error:
        raise FormatError(f"{source} is not readable by OpenCV ({_reason(error)}); write it again") from error
    finally:
        storage.release()
    return found


def _numbers(node: cv2.FileNode) -> NDArray[np.float64] | None:
    if node.isInt() or node.isReal():
        return np.array(node.real())
    if node.isMap():
        matrix = node.mat()
        return None if matrix is None else np.asarray(matrix, np.float64)
    if node.isSeq():
        items = [node.at(index) for index in range(node.size())]
        if items and all(item.isInt() or item.isReal() for item in items):
            return np.array([item.real() for item in items])
    return None


def _reason(error: BaseException) -> str:
    error = error.__cause__ or error
    return str(getattr(error, "err", "") or error).strip().splitlines()[0].strip()


def _size(source: str, nodes: Nodes, image_shape: tuple[int, ...] | None) -> tuple[int, int]:
    for name in SIZES:
        if name in nodes and nodes[name].size == 2:
            return round(float(nodes[name].flat[0])), round(float(nodes[name].flat[1]))
    width, height = (next((nodes[n] for n in names if n in nodes), None) for names in (WIDTHS, HEIGHTS))
    if width is not None and height is not None:
        return round(float(width)), round(float(height))
    if image_shape is None:
        raise FormatError(f"{source} does not hold the size of the images; read it together with them")
    return image_shape[1], image_shape[0]


def _rectified(source: str, known: Nodes, size: tuple[int, int]) -> Calibration | None:
    if not {"P1", "P2"} <= set(known):
        return None
    return calibration_of(
        source, ("P1", "P2"), shape_3x4(source, "P1", known["P1"]), shape_3x4(source, "P2", known["P2"]), size
    )


def _rig(
    source: str, known: Nodes, size: tuple[int, int], rectified: Calibration | None, *, fisheye: bool
) -> StereoRig | None:
    if not {"M1", "M2", "R", "T"} <= set(known):
        return None
    none = np.zeros(0)
    left, right = (
        camera_of(
            shape_3x3(source, f"M{i}", known[f"M{i}"]), known.get(f"D{i}", none), size, equidistant=fisheye
        )
        for i in (1, 2)
    )  # fmt: skip
    rotation = _rotation(source, "R", known["R"])
    if known["T"].size != 3:
        raise FormatError(f"{source}: T has {known['T'].size} numbers and must have 3")
    x, y, z = (float(value) for value in known["T"].ravel())
    rectification = None
    if rectified is not None and {"R1", "R2"} <= set(known):
        rotations = [_rotation(source, name, known[name]) for name in ("R1", "R2")]
        rectification = Rectification(rotations[0], rotations[1], rectified)
    return StereoRig(left, right, rotation, (x, y, z), rectification)


def _rotation(source: str, name: str, value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rotation (3, 3) of a matrix or a Rodrigues vector."""
    if value.size == 3:
        return np.asarray(cv2.Rodrigues(value.reshape(3, 1))[0])
    matrix = shape_3x3(source, name, value)
    problem = rotation_problem(matrix)
    if problem:
        raise FormatError(f"{source}: {name}: {problem}")
    return nearest_rotation(matrix)
