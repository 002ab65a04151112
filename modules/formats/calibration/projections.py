"""Rectified geometry from projection matrices, as ROS, OpenCV and KITTI write it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modules.formats.errors import FormatError
from modules.primitives.frames import nearest_rotation, rotation_problem
from modules.types import Calibration, Camera, Rectification, StereoRig

Matrix = NDArray[np.float64]
SAME_PX = 0.5  # focal lengths and rows of a rectified pair may differ by less


def calibration_of(
    source: str, names: tuple[str, str], left: Matrix, right: Matrix, size: tuple[int, int]
) -> Calibration:
    """Return the geometry of a rectified pair from its projection matrices (3, 4).

    Parameters
    ----------
    source : str
        Name of the file, for messages.
    names : (str, str)
        What the file calls the two matrices.
    left, right : float64 (3, 4)
        `P = [f 0 cx Tx; 0 f cy 0; 0 0 1 0]` with `Tx = -f x` for a camera at x.
    size : (int, int)
        Width and height of the rectified images, px.

    Raises
    ------
    FormatError
        When these are no matrices of two parallel cameras beside each other.
    """
    fl, fr, cyl, cyr = left[0, 0], right[0, 0], left[1, 2], right[1, 2]
    if abs(fl - fr) > SAME_PX or abs(cyl - cyr) > SAME_PX or abs(left[1, 1] - fl) > SAME_PX:
        raise FormatError(
            f"{source}: {names[0]} has f {fl:g} and {left[1, 1]:g}, cy {cyl:g} and {names[1]} has f {fr:g}, cy {cyr:g} "
            "px; the two of a rectified pair have one focal length and one cy: these are of different pairs"
        )
    if fl <= 0.0:
        raise FormatError(f"{source}: {names[0]} has a focal length of {fl:g} px and it must be above 0")
    baseline = float(left[0, 3] - right[0, 3]) / float(fl)
    if baseline == 0.0 and abs(right[1, 3] - left[1, 3]) > 0.0:
        raise FormatError(
            f"{source}: {names[1]} is of a camera above or below the other one; turn both images by 90 degrees"
        )
    return Calibration(
        focal_px=float(fl),
        cx_px=float(left[0, 2]),
        cy_px=float(cyl),
        baseline_m=baseline,
        width_px=size[0],
        height_px=size[1],
        doffs_px=float(right[0, 2] - left[0, 2]),
    )


def rig_of_rectification(left: Camera, right: Camera, rectification: Rectification) -> StereoRig:
    """Return the rig whose pose follows from the rectification: `p_right = R2' (R1 p_left - (B, 0, 0))`."""
    turn = rectification.right_rotation.T @ rectification.left_rotation
    x, y, z = (float(v) for v in -rectification.right_rotation.T @ [rectification.calibration.baseline_m, 0.0, 0.0])
    return StereoRig(left, right, nearest_rotation(turn), (x, y, z), rectification)


def shape_3x4(source: str, name: str, matrix: Matrix) -> Matrix:
    """Return a projection matrix as (3, 4), or say what it is."""
    if matrix.size != 12:
        raise FormatError(f"{source}: {name} has {matrix.size} numbers and a projection matrix has 12, 3 rows of 4")
    return matrix.reshape(3, 4)


def shape_3x3(source: str, name: str, matrix: Matrix) -> Matrix:
    """Return a matrix as (3, 3), or say what it is."""
    if matrix.size != 9:
        raise FormatError(f"{source}: {name} has {matrix.size} numbers and must have 9, 3 rows of 3")
    return matrix.reshape(3, 3)


def rigid(source: str, name: str, rows: Matrix) -> Matrix:
    """Return the rigid transform (4, 4) of its first three rows, or say why it is none."""
    problem = rotation_problem(rows[:3, :3])
    if problem:
        raise FormatError(f"{source}: the rotation of {name}: {problem}")
    transform = np.vstack([rows[:3], [0.0, 0.0, 0.0, 1.0]])
    transform[:3, :3] = nearest_rotation(transform[:3, :3])
    return transform


def camera_of(
    matrix: Matrix, distortion: Matrix | list[float], size: tuple[int, int], *, equidistant: bool = False
) -> Camera:
    """Return a camera of its matrix (3, 3) and coefficients; coefficients that are all 0 are none."""
    coefficients = tuple(float(value) for value in np.ravel(distortion))
    return Camera(
        focal_px=(float(matrix[0, 0]), float(matrix[1, 1])),
        centre_px=(float(matrix[0, 2]), float(matrix[1, 2])),
        width_px=size[0],
        height_px=size[1],
        # For the equidistant model zeros are a lens of their own, r = f theta.
        distortion=coefficients if equidistant or any(coefficients) else (),
        model="equidistant" if equidistant else "radtan",
    )
