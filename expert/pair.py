"""A stereo pair as the caller gives it: images, and what is known of the cameras and the attitude."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modules.formats.attitude import convention_of, read_attitude
from modules.formats.calibration import (
    CalibrationFile,
    CalibrationSource,
    check_calibration,
    for_images,
    read_calibration,
)
from modules.formats.images import read_image
from modules.primitives.frames import Convention, mount_in_flu, rectified_mount
from modules.rectification.rectify import RectificationError, already_rectified, rectify_images
from modules.types import (
    Attitude,
    Calibration,
    DisparityRange,
    Image,
    Mask,
    Matching,
    Mount,
    Scene,
    StereoRig,
    Views,
)

MIN_SIDE_PX = 16
MAX_MEGAPIXELS = 100.0
_ONLY_CAMERA = re.compile(r"left|l|(im|img|image|cam|camera|view)[_-]?\d?", re.IGNORECASE)  # left_1 is one of a series


class PairError(ValueError):
    """A pair that cannot be used; the message names the value, the limit and the remedy."""


def _name_of(left: Path) -> str:
    """Name a pair after the file of its left image, or after the folder where that only names the camera."""
    path = Path(os.path.abspath(left))
    name = path.parent.name if _ONLY_CAMERA.fullmatch(path.stem) and path.parent.name else path.stem
    return name.encode("utf-8", "backslashreplace").decode()  # names of files need not be UTF-8


def _checked_image(name: str, image: object) -> Image:
    if not isinstance(image, np.ndarray):
        raise PairError(f"{name}: expected a NumPy array, got {type(image).__name__}; load files with StereoPair.load")
    if np.issubdtype(image.dtype, np.floating) and not np.isfinite(image).all():
        raise PairError(f"{name} contains NaN or infinite values; replace them and convert to uint8 or uint16")
    if image.dtype not in (np.uint8, np.uint16):
        raise PairError(f"{name} has dtype {image.dtype}; convert it to uint8 or uint16")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.ndim == 3 and image.shape[2] == 4:
        image = image[..., :3]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise PairError(f"{name} has shape {image.shape}; expected (H, W), (H, W, 3) RGB or (H, W, 4) RGBA")
    rows, columns = image.shape[:2]
    if min(rows, columns) < MIN_SIDE_PX:
        raise PairError(f"{name} is {columns}x{rows}; each side must have at least {MIN_SIDE_PX} px")
    if rows * columns > MAX_MEGAPIXELS * 1e6:
        raise PairError(f"{name} is {columns}x{rows}; at most {MAX_MEGAPIXELS:g} megapixels are allowed: downscale it")
    return np.ascontiguousarray(image)


def _checked_mask(name: str, mask: object, image: Image) -> Mask:
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != image.shape[:2]:
        found = f"{mask.dtype} of shape {mask.shape}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise PairError(f"{name} is {found}; expected bool of shape {image.shape[:2]}, True where a pixel may be used")
    return np.ascontiguousarray(mask)


@dataclass(frozen=True)
class Preparation:
    """What was done to a pair while it was loaded, before anything was measured.

    Attributes
    ----------
    calibration_format : str or None
        Format of the calibration file.
    rectified_here : bool
        Whether the images were rectified with the calibration.
    calibration_scale : float
        Factor by which the calibration was scaled to the size of the images.
    """

    calibration_format: str | None = None
    rectified_here: bool = False
    calibration_scale: float = 1.0

    def told(self, valid_fraction: float) -> list[str]:
        """Say it for the report; `valid_fraction` is the part of the rectified images that the cameras saw."""
        said = []
        if self.calibration_scale != 1.0:
            said.append(f"the calibration was scaled by {self.calibration_scale:.4g} to the size of the images")
        if self.rectified_here:
            what = f"the {self.calibration_format} calibration" if self.calibration_format else "the calibration"
            said.append(f"the images were rectified here with {what}; {valid_fraction:.1%} of their pixels are valid")
        return said


@dataclass(frozen=True)
class StereoPair:
    """A rectified stereo pair; `load` and `rectify` also take raw images.

    Parameters
    ----------
    left, right : (H, W), (H, W, 3) RGB or (H, W, 4) RGBA, uint8 or uint16
        Images of one shape and dtype.
    disparity_range_px : (int, int), optional
        Disparities to search, `min <= d < max`, px. The system estimates the range where it is not given.
    calibration : Calibration, optional
        Without it the disparity is still computed, but no 3D points.
    attitude : Attitude, optional
        Of the body, REP 103. Without it the ground plane is fitted.
    mount : Mount, optional
        Where the left camera sits on the body.
    name : str
        Used in reports.
    left_mask, right_mask : bool (H, W), optional
        True where a pixel may be used; everywhere by default.
    preparation : Preparation
        What was done on the way here.

    Raises
    ------
    PairError
        The images do not fit together or cannot be used.
    """

    left: Image
    right: Image
    disparity_range_px: tuple[int, int] | None = None
    calibration: Calibration | None = None
    attitude: Attitude | None = None
    mount: Mount | None = None
    name: str = "pair"
    left_mask: Mask | None = None
    right_mask: Mask | None = None
    preparation: Preparation = Preparation()

    def __post_init__(self) -> None:
        left, right = _checked_image("left", self.left), _checked_image("right", self.right)
        if left.shape[:2] != right.shape[:2]:
            raise PairError(
                f"left is {left.shape[1]}x{left.shape[0]} and right is {right.shape[1]}x{right.shape[0]}; "
                "crop them to one size or rectify the pair first"
            )
        if left.dtype != right.dtype:
            raise PairError(f"left is {left.dtype} and right is {right.dtype}; convert both to one bit depth")
        if left.ndim != right.ndim:
            raise PairError("one image is gray and the other is colour; convert both to gray or both to RGB")
        object.__setattr__(self, "left", left)
        object.__setattr__(self, "right", right)
        for name, image in (("left_mask", left), ("right_mask", right)):
            mask = getattr(self, name)
            if mask is not None:
                object.__setattr__(self, name, _checked_mask(name, mask, image))
        if self.disparity_range_px is not None:
            self._check_range(self.disparity_range_px)
        if self.calibration is not None:
            check_calibration(self.calibration, left.shape[:2])

    def _check_range(self, range_px: tuple[int, int]) -> None:
        low, high = range_px
        width = self.left.shape[1]
        if high <= low:
            raise PairError(f"disparity range {low} {high} is empty; the second number must be larger than the first")
        if high - low > width or max(abs(low), abs(high)) > width:
            raise PairError(f"disparity range {low} {high} is wider than the image ({width} px); narrow it")

    @classmethod
    def load(
        cls,
        left: str | Path,
        right: str | Path,
        *,
        calibration: CalibrationSource | None = None,
        attitude: str | Path | Attitude | None = None,
        disparity_range_px: tuple[int, int] | None = None,
        rectified: bool = False,
        alpha: float | None = None,
        scale_calibration: bool = False,
        convention: Convention = "rep103",
    ) -> StereoPair:
        """Read a pair from files, and rectify it where the calibration is of raw cameras.

        Parameters
        ----------
        left, right : path
        calibration : path, or two paths, optional
            Any format of `modules.formats.read_calibration`.
        attitude : path or Attitude, optional
        disparity_range_px : (int, int), optional
            Of the rectified images.
        rectified : bool
            Whether the images are rectified already, although the calibration also describes the raw cameras.
        alpha : float, optional
            0 zooms until all pixels are valid, 1 keeps all the cameras saw; see `modules.rectification.rectify`.
        scale_calibration : bool
            Scale a calibration that was made for another size of the same images.
        convention : {"rep103", "aerospace", "euroc"}
            Axes of the inertial unit, for calibrations that state the cameras in them (EuRoC, Kalibr with a unit). An
            attitude file states its own.

        Raises
        ------
        modules.formats.FormatError
            A file is missing, unreadable or not what it should be.
        PairError
            The images do not fit together.
        """
        if attitude is not None and not isinstance(attitude, Attitude):
            convention = convention_of(attitude)
            attitude = read_attitude(Path(attitude))
        left_image, right_image = read_image(Path(left)), read_image(Path(right))
        if left_image.shape[:2] != right_image.shape[:2]:
            raise PairError(
                f"{left} is {left_image.shape[1]}x{left_image.shape[0]} and {right} is "
                f"{right_image.shape[1]}x{right_image.shape[0]}; crop them to one size or rectify the pair first"
            )
        pair = cls(
            left_image,
            right_image,
            disparity_range_px=disparity_range_px,
            attitude=attitude,
            name=_name_of(Path(left)),
        )
        if calibration is None:
            return pair
        stated = read_calibration(calibration, pair.left.shape)
        fitting = for_images(stated, pair.left.shape, scale=scale_calibration)
        done = Preparation(stated.format, calibration_scale=_width(fitting) / _width(stated))
        mount = fitting.mount
        if fitting.body_is_imu and mount is not None:
            mount = None if pair.attitude is None else mount_in_flu(mount, convention)
        pair = replace(pair, mount=mount, preparation=done)
        if fitting.rig is not None and not rectified:
            return pair.rectify(fitting.rig, alpha=alpha)
        if fitting.rectified is None:
            raise PairError(
                f"the calibration ({fitting.format}) describes raw cameras and no rectified pair; "
                "leave out --rectified, or give the calibration of the rectified images"
            )
        return replace(pair, calibration=fitting.rectified)

    def rectify(self, rig: StereoRig, *, alpha: float | None = None) -> StereoPair:
        """Return the pair rectified, its images being as the cameras of `rig` took them.

        Parameters
        ----------
        rig : StereoRig
        alpha : float, optional
            0 zooms until all pixels are valid, 1 keeps all the cameras saw; by default what the rig prescribes, or 0.

        Returns
        -------
        StereoPair
            With the rectified calibration, masks of the pixels that the cameras saw, and the mount turned along. A rig
            that is rectified already leaves the images as they are.

        Raises
        ------
        PairError
            The rig cannot be rectified, or is of another size.
        """
        rows, columns = self.left.shape[:2]
        if (rig.left.width_px, rig.left.height_px) != (columns, rows):
            raise PairError(
                f"the rig is of {rig.left.width_px}x{rig.left.height_px} px and the images are {columns}x{rows} px; "
                "use the calibration of these images"
            )
        if self.left_mask is not None or self.right_mask is not None:
            raise PairError("the pair has masks of its raw images; rectify it first and give masks of the result")
        ready = already_rectified(rig)
        if ready is not None:
            return replace(self, calibration=ready)
        try:
            made = rectify_images(self.left, self.right, rig, alpha)
        except RectificationError as error:
            raise PairError(str(error)) from error
        plan = made.rectification
        return replace(
            self,
            left=made.left,
            right=made.right,
            left_mask=None if made.left_mask.all() else made.left_mask,
            right_mask=None if made.right_mask.all() else made.right_mask,
            calibration=plan.calibration,
            mount=rectified_mount(self.mount or Mount(), plan.left_rotation),
            preparation=replace(self.preparation, rectified_here=True),
        )

    def without_masked(self, path: str | Path) -> StereoPair:
        """Return the pair without the black pixels of a mask, in which the robot sees itself, say.

        Parameters
        ----------
        path : path
            Image as large as the rectified left one.

        Raises
        ------
        modules.formats.FormatError
            The mask cannot be read.
        PairError
            It is of another size, or black everywhere.
        """
        image = read_image(Path(path))
        if image.shape[:2] != self.left.shape[:2]:
            raise PairError(
                f"{path} is {image.shape[1]}x{image.shape[0]} and the left image is "
                f"{self.left.shape[1]}x{self.left.shape[0]}; make the mask on the rectified left image"
            )
        usable = np.asarray(image > 0 if image.ndim == 2 else (image > 0).any(axis=2), bool)
        if not usable.any():
            raise PairError(f"{path} is black everywhere, so no pixel is left; paint white what may be used")
        return replace(self, left_mask=usable if self.left_mask is None else usable & self.left_mask)

    @property
    def valid_fraction(self) -> float:
        """Part of the pixels that may be used, the smaller of the two images."""
        masks = [mask for mask in (self.left_mask, self.right_mask) if mask is not None]
        return min([1.0, *(float(mask.mean()) for mask in masks)])

    @property
    def views(self) -> Views:
        """The pair as the correction stage takes it."""
        return Views(self.left, self.right, self.left_mask, self.right_mask)

    def scene(self, matching: Matching) -> Scene:
        """Return a matching of the pair, which has a disparity, as the reconstruction stage takes it."""
        if matching.disparity is None:
            raise ValueError("the matching has no disparity")
        return Scene(
            disparity=matching.disparity,
            left=self.left,
            calibration=self.calibration,
            attitude=self.attitude,
            mount=self.mount or Mount(),
            mask=matching.views.left_mask,
        )

    @property
    def given_range(self) -> DisparityRange | None:
        """The disparity range the caller gave."""
        return None if self.disparity_range_px is None else DisparityRange(*self.disparity_range_px)


def _width(found: CalibrationFile) -> float:
    geometry = found.rectified or (found.rig.left if found.rig is not None else None)
    return float(geometry.width_px) if geometry is not None else 1.0
