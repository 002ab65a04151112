"""Middlebury `calib.txt`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import number, whole
from modules.formats.calibration.file import CalibrationFile
from modules.formats.errors import FormatError
from modules.types import Calibration

DOFFS_TOLERANCE_PX = 0.5


def read_middlebury(source: str, text: str) -> CalibrationFile:
    """Read the calibration of a rectified pair; the baseline is in mm.

    References
    ----------
    D. Scharstein et al., High-resolution stereo datasets with subpixel-accurate ground truth, GCPR 2014.
    """
    values: dict[str, object] = {}
    for line in text.splitlines():
        name, equals, value = line.partition("=")
        if equals:
            values[name.strip()] = value.strip()
    camera = _camera_matrix(source, "cam0", str(values["cam0"]))
    doffs = number(source, values, "doffs", 0.0)
    if "cam1" in values:
        expected = float(_camera_matrix(source, "cam1", str(values["cam1"]))[0, 2] - camera[0, 2])
        if "doffs" in values and abs(doffs - expected) > DOFFS_TOLERANCE_PX:
            raise FormatError(
                f"{source}: doffs is {doffs:g} px and cx of cam1 minus cx of cam0 is {expected:g} px; they must agree, "
                "or depths are wrong and far points come to lie behind the camera: correct doffs"
            )
        doffs = doffs if "doffs" in values else expected
    return CalibrationFile(
        "Middlebury",
        rectified=Calibration(
            focal_px=float(camera[0, 0]),
            cx_px=float(camera[0, 2]),
            cy_px=float(camera[1, 2]),
            baseline_m=number(source, values, "baseline") / 1000.0,
            width_px=whole(source, "width", number(source, values, "width")),
            height_px=whole(source, "height", number(source, values, "height")),
            doffs_px=doffs,
        ),
    )


def _camera_matrix(source: str, name: str, text: str) -> NDArray[np.float64]:
    try:
        entries = [float(entry) for entry in text.strip("[] \t").replace(";", " ").replace(",", " ").split()]
    except ValueError as error:
        raise FormatError(f"{source}: {name} is {text!r} and must be [f 0 cx; 0 f cy; 0 0 1]") from error
    if len(entries) != 9 or not np.isfinite(entries).all():
        raise FormatError(f"{source}: {name} is {text!r} and must hold nine finite numbers, [f 0 cx; 0 f cy; 0 0 1]")
    return np.array(entries).reshape(3, 3)
