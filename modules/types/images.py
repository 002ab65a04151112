"""Images and pairs of views."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
Mask: TypeAlias = NDArray[np.bool_]
FloatImage: TypeAlias = NDArray[np.float32]
Side: TypeAlias = Literal["left", "right"]


def full_scale(image: Image) -> int:
    """Return the largest value of the image's dtype, 255 or 65535."""
    return int(np.iinfo(image.dtype).max)


def dn_scale(image: Image) -> float:
    """Return the stored levels per DN: 1 for 8 bit, 257 for 16 bit."""
    return full_scale(image) / 255.0


@dataclass(frozen=True)
class Correspondences:
    """Corresponding points of a pair.

    Attributes
    ----------
    left_xy, right_xy : float32 (N, 2)
        Column and row of each point in px.
    """

    left_xy: NDArray[np.float32]
    right_xy: NDArray[np.float32]

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.left_xy)


@dataclass(frozen=True)
class Views:
    """The two images of a pair on their way through correction.

    Attributes
    ----------
    left, right : (H, W) or (H, W, 3), uint8 or uint16
        Images of one shape and dtype. Disparity always refers to the geometry of the original left image: operators
        that align rows warp the right image.
    left_mask, right_mask : bool (H, W) or None
        True where the pixel may be used; None means everywhere.
    correspondences : Correspondences or None
        Sparse matches, where a probe has measured them.
    unchanged : pair of images or None
        Both images with their own intensities, in the geometry of `left` and `right`, where operators have changed
        intensities; None where none has.
    """

    left: Image
    right: Image
    left_mask: Mask | None = None
    right_mask: Mask | None = None
    correspondences: Correspondences | None = None
    unchanged: tuple[Image, Image] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return int(self.left.shape[0]), int(self.left.shape[1])

    def with_images(self, left: Image, right: Image) -> Views:
        """Return the same views with other intensities; the first ones are kept as `unchanged`."""
        return replace(self, left=left, right=right, unchanged=self.as_seen)

    @property
    def as_seen(self) -> tuple[Image, Image]:
        """Both images with their own intensities: what all trials of a pair can be judged by, whatever they matched."""
        return (self.left, self.right) if self.unchanged is None else self.unchanged
