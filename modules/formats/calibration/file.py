"""What a calibration file says, whatever its format."""

from __future__ import annotations

from dataclasses import dataclass

from modules.types import Calibration, Mount, StereoRig


@dataclass(frozen=True)
class CalibrationFile:
    """What a calibration file says.

    Attributes
    ----------
    format : str
        Name of the format, e.g. `OpenCV`.
    rectified : Calibration or None
        Geometry of images that are rectified already.
    rig : StereoRig or None
        The cameras as they are; None where the file describes rectified images alone.
    mount : Mount or None
        Where the left camera, as it is, sits on the body.
    body_is_imu : bool
        Whether the body of `mount` is the inertial unit, whose axes say nothing of up and ahead without its attitude.
    """

    format: str
    rectified: Calibration | None = None
    rig: StereoRig | None = None
    mount: Mount | None = None
    body_is_imu: bool = False
