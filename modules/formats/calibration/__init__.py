"""Calibrations of stereo cameras, in and out."""

from modules.formats.calibration.file import CalibrationFile
from modules.formats.calibration.own import calibration_schema
from modules.formats.calibration.read import (
    CalibrationSource,
    check_calibration,
    for_images,
    read_calibration,
    write_calibration,
)

__all__ = [
    "CalibrationFile",
    "CalibrationSource",
    "calibration_schema",
    "check_calibration",
    "for_images",
    "read_calibration",
    "write_calibration",
]
