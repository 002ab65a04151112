"""Whether a calibration can be: every reader ends here, so that one fault has one sentence."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from modules.formats.calibration.file import CalibrationFile
from modules.formats.errors import FormatError
from modules.primitives.frames import rotation_problem
from modules.types import Calibration, Camera, StereoRig

MIN_FOCAL_PX = 50.0  # a lens of 3 to 50 mm read as pixels falls below
MIN_FOCAL_PER_WIDTH = 0.1  # a field of view of 157 degrees
MAX_FOCAL_PER_WIDTH = 50.0
MIN_BASELINE_M = 1e-3
MAX_BASELINE_M = 100.0  # more is a baseline in mm
MAX_UNITLESS_BASELINE_M = 20.0  # in files that do not state the unit
MAX_CONVERGENCE_DEG = 60.0  # beyond it two perspective images hardly have a common rectified plane
MAX_PIXEL_ASPECT = 1.1
COEFFICIENTS = {"radtan": (0, 4, 5, 8, 12, 14), "equidistant": (0, 4)}


def checked(source: str, found: CalibrationFile, *, unit_stated: bool) -> CalibrationFile:
    """Return `found`, or raise one error with every impossible value.

    Parameters
    ----------
    source : str
        Name of the file, for the message.
    found : CalibrationFile
    unit_stated : bool
        Whether the format states the unit of the baseline.

    Raises
    ------
    FormatError
    """
    longest = MAX_BASELINE_M if unit_stated else MAX_UNITLESS_BASELINE_M
    problems: list[str] = []
    if found.rectified is not None:
        problems += _of_rectified(found.rectified, longest)
    if found.rig is not None:
        problems += _of_rig(found.rig, longest)
    if problems:
        raise FormatError(f"{source}: " + ". ".join(dict.fromkeys(problems)))
    return found


def _of_rectified(c: Calibration, longest_m: float) -> Iterator[str]:
    yield from _of_size(c.width_px, c.height_px)
    yield from _of_baseline(c.baseline_m, longest_m)
    yield from _of_focal("the focal length", c.focal_px, c.width_px)
    yield from _of_centre("the principal point", c.cx_px, c.cy_px, c.width_px, c.height_px)
    if c.width_px > 0 and abs(c.doffs_px) > c.width_px:
        yield (
            f"doffs is {c.doffs_px:g} px, beyond the width of {c.width_px} px; "
            "it is cx of the right camera minus cx of the left one"
        )


def _of_rig(rig: StereoRig, longest_m: float) -> Iterator[str]:
    for name, camera in (("left", rig.left), ("right", rig.right)):
        yield from _of_camera(name, camera)
    if (rig.left.width_px, rig.left.height_px) != (rig.right.width_px, rig.right.height_px):
        yield (
            f"the left camera has {rig.left.width_px}x{rig.left.height_px} px and the right one "
            f"{rig.right.width_px}x{rig.right.height_px} px; they must have one size"
        )
    problem = rotation_problem(rig.rotation)
    if problem:
        yield f"the rotation between the cameras: {problem}"
        return
    turn = float(np.degrees(np.arccos(np.clip((np.trace(rig.rotation) - 1.0) / 2.0, -1.0, 1.0))))
    if turn > MAX_CONVERGENCE_DEG:
        yield (
            f"the cameras are turned by {turn:.0f} deg against each other, above {MAX_CONVERGENCE_DEG:g} deg; "
            "check the rotation, and that it is not in degrees or inverted"
        )
    x, y, z = (
        float(value) for value in -rig.rotation.T @ np.asarray(rig.translation_m)
    )  # right camera, seen from left
    if abs(x) < max(abs(y), abs(z)):
        way = "above or below" if abs(y) >= abs(z) else "before or behind"
        yield (
            f"the right camera stands at ({x:.4g}, {y:.4g}, {z:.4g}) m of the left one, {way} it and not beside it; "
            "turn the images of an upright rig by 90 degrees, with its calibration"
        )
    else:
        yield from _of_baseline(float(np.copysign(np.linalg.norm([x, y, z]), x)), longest_m)


def _of_camera(name: str, camera: Camera) -> Iterator[str]:
    yield from _of_size(camera.width_px, camera.height_px)
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    yield from _of_focal(f"the focal length of the {name} camera", fx, camera.width_px)
    if fx > 0.0 and not 1.0 / MAX_PIXEL_ASPECT <= fy / fx <= MAX_PIXEL_ASPECT:
        yield f"the focal lengths of the {name} camera are {fx:g} and {fy:g} px; they must agree within 10 %"
    yield from _of_centre(f"the principal point of the {name} camera", cx, cy, camera.width_px, camera.height_px)
    allowed = COEFFICIENTS[camera.model]
    if len(camera.distortion) not in allowed:
        yield (
            f"the {name} camera has {len(camera.distortion)} distortion coefficients and the model '{camera.model}' "
            f"takes {', '.join(str(count) for count in allowed[1:])} or none"
        )
    elif any(abs(value) > 100.0 for value in camera.distortion):
        yield f"the {name} camera has the distortion {list(camera.distortion)}; no lens is beyond 100, check them"


def _of_size(width: int, height: int) -> Iterator[str]:
    if width <= 0 or height <= 0:
        yield f"the size is {width}x{height} px and must be positive; give that of the images"


def _of_baseline(baseline_m: float, longest_m: float) -> Iterator[str]:
    if baseline_m <= 0.0:
        yield f"the baseline is {baseline_m:g} m and must be above 0; swap the images if it is negative"
    elif baseline_m > longest_m:
        yield f"the baseline is {baseline_m:g} m, above {longest_m:g} m; is it in mm? divide by 1000"
    elif baseline_m < MIN_BASELINE_M:
        yield f"the baseline is {baseline_m:g} m, below {MIN_BASELINE_M:g} m; give it in m"


def _of_focal(what: str, focal_px: float, width_px: int) -> Iterator[str]:
    smallest = max(min(MIN_FOCAL_PX, 0.5 * width_px), MIN_FOCAL_PER_WIDTH * width_px)  # thumbnails have small ones
    if focal_px <= 0.0:
        yield f"{what} is {focal_px:g} px and must be above 0"
    elif focal_px < smallest:
        yield (
            f"{what} is {focal_px:g} px, below {smallest:g} px for a width of {width_px} px; "
            "is it in mm? divide by the pixel pitch in mm"
        )
    elif width_px > 0 and focal_px > MAX_FOCAL_PER_WIDTH * width_px:
        yield (
            f"{what} is {focal_px:g} px, above {MAX_FOCAL_PER_WIDTH * width_px:g} px for a width of "
            f"{width_px} px; give it in px of these images"
        )


def _of_centre(what: str, cx: float, cy: float, width: int, height: int) -> Iterator[str]:
    """Reject a principal point far outside the image: a crop moves it, but hardly by an image's width."""
    if width > 0 and height > 0 and not (-width <= cx <= 2 * width and -height <= cy <= 2 * height):
        yield (
            f"{what} is ({cx:g}, {cy:g}) px, far outside the image of {width}x{height} px; "
            "the calibration is for another size of image or its numbers are in another order"
        )
