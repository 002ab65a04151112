"""KITTI `calib.txt` and `calib_cam_to_cam.txt`: projection matrices of rectified images."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from modules.formats.calibration.file import CalibrationFile
from modules.formats.calibration.projections import calibration_of, shape_3x4
from modules.formats.errors import FormatError

LINE = re.compile(r"^(P[0-3]|P_rect_0[0-3]|S_rect_0[0-3]):\s*(.*)$", re.MULTILINE)
GRAY, COLOUR = (0, 1), (2, 3)  # cameras of the gray and of the colour pair


def read_kitti(source: str, text: str, image_shape: tuple[int, ...] | None) -> CalibrationFile:
    """Read the projection matrices P0 and P1 of gray images, or P2 and P3 of colour ones.

    Parameters
    ----------
    source, text : str
    image_shape : tuple of int, optional
        Shape of the images: the file of the stereo and odometry benchmarks does not hold it, and colour or gray
        says which of the two pairs of cameras is meant.

    References
    ----------
    A. Geiger, P. Lenz, C. Stiller and R. Urtasun, Vision meets robotics: the KITTI dataset, IJRR 32(11), 2013.
    """
    matrices: dict[int, NDArray[np.float64]] = {}
    sizes: dict[int, tuple[int, int]] = {}
    for name, value in LINE.findall(text):
        try:
            entries = np.array([float(entry) for entry in value.split()])
        except ValueError as error:
            raise FormatError(f"{source}: {name} is {value!r} and must be numbers") from error
        if not np.isfinite(entries).all():
            raise FormatError(f"{source}: {name} is {value!r} and must be finite")
        if name.startswith("S"):
            sizes[int(name[-1])] = (round(entries[0]), round(entries[1]))
        else:
            matrices[int(name[-1])] = shape_3x4(source, name, entries)
    pairs = [pair for pair in (GRAY, COLOUR) if set(pair) <= set(matrices)]
    if not pairs:
        found = ", ".join(f"P{index}" for index in sorted(matrices))
        raise FormatError(f"{source} has {found} and a stereo pair needs P0 and P1 (gray) or P2 and P3 (colour)")
    colour = image_shape is not None and len(image_shape) == 3
    left, right = COLOUR if colour and COLOUR in pairs else pairs[0]
    size = sizes.get(left)
    if size is None:
        if image_shape is None:
            raise FormatError(f"{source} does not hold the size of the images; read it together with them")
        size = (image_shape[1], image_shape[0])
    names = (f"P{left}", f"P{right}")
    return CalibrationFile("KITTI", rectified=calibration_of(source, names, matrices[left], matrices[right], size))
