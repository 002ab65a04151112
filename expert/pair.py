"""A stereo pair as the caller gives it: images, and what is known of the cameras and the attitude."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modules.formats.attitude import read_attitude
from modules.formats.calibration import check_calibration, read_calibration
from modules.formats.images import read_image
from modules.types import Attitude, Calibration, DisparityRange, Image, Mount, Views

MIN_SIDE_PX = 16
MAX_MEGAPIXELS = 100.0


class PairError(ValueError):
    """A pair that cannot be used; the message names the value, the limit and the remedy."""


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


@dataclass(frozen=True)
class StereoPair:
    """A rectified stereo pair.

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
        calibration: str | Path | None = None,
        attitude: str | Path | Attitude | None = None,
        disparity_range_px: tuple[int, int] | None = None,
    ) -> StereoPair:
        """Read a pair from files.

        Raises
        ------
        modules.formats.FormatError
            A file is missing, unreadable or not what it should be.
        PairError
            The images do not fit together.
        """
        camera: Calibration | None = None
        mount: Mount | None = None
        if calibration is not None:
            camera, mount = read_calibration(Path(calibration))
        if attitude is not None and not isinstance(attitude, Attitude):
            attitude = read_attitude(Path(attitude))
        left_image, right_image = read_image(Path(left)), read_image(Path(right))
        if left_image.shape[:2] != right_image.shape[:2]:
            raise PairError(
                f"{left} is {left_image.shape[1]}x{left_image.shape[0]} and {right} is "
                f"{right_image.shape[1]}x{right_image.shape[0]}; crop them to one size or rectify the pair first"
            )
        return cls(
            left_image,
            right_image,
            disparity_range_px=disparity_range_px,
            calibration=camera,
            attitude=attitude,
            mount=mount,
            name=Path(left).stem.encode("utf-8", "backslashreplace").decode(),  # names of files need not be UTF-8
        )

    @property
    def views(self) -> Views:
        """The pair as the correction stage takes it."""
        return Views(self.left, self.right)

    @property
    def given_range(self) -> DisparityRange | None:
        """The disparity range the caller gave."""
        return None if self.disparity_range_px is None else DisparityRange(*self.disparity_range_px)
