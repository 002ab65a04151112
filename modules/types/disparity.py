"""Disparities: ranges, validity, and the state of the matching stage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from modules.types.images import FloatImage, Mask, Views

NAN_BITS = np.uint32(0x7FC00000)  # set in every quiet NaN of IEEE 754; with them any float32 is one


@dataclass(frozen=True)
class DisparityRange:
    """Disparities to search, in whole px: `min_px <= d < max_px`, like a Python range."""

    min_px: int
    max_px: int

    def __post_init__(self) -> None:
        if self.max_px <= self.min_px:
            raise ValueError(
                f"disparity range {self.min_px} {self.max_px} is empty; the second number must be larger than the first"
            )

    @property
    def count(self) -> int:
        """Number of disparities searched."""
        return self.max_px - self.min_px


class Invalid(IntFlag):
    """Reasons why a pixel has no disparity; 0 means valid. Stored as uint16."""

    NO_MATCH = 1  # the matcher gave no disparity and no narrower reason
    MASKED = 2  # excluded by a mask of the pair
    OUTSIDE = 4  # its match would lie outside the right image
    RANGE_BORDER = 8  # the best disparity is at an end of the searched range
    LEFT_RIGHT = 16  # the match of the match is another pixel
    NOT_UNIQUE = 32  # a second disparity is nearly as good
    FLAT_MINIMUM = 64  # the cost hardly depends on the disparity
    SPECKLE = 128  # part of a small island of similar disparity
    SATURATED = 256  # clipped in either image
    TEXTURELESS = 512  # too little texture to decide
    LOW_CONFIDENCE = 1024  # below the confidence limit
    SKY = 2048  # sky, no terrain
    FILLED = 4096  # in a filled product only: the value was interpolated


def blanked(values: FloatImage, where: Mask) -> FloatImage:
    """Return a copy of `values` (float32) that is NaN at `where`.

    Setting the bits that NaN has needs no branch; `np.where` takes up to ten times as long on scattered pixels.
    """
    bits = np.multiply(where, NAN_BITS, dtype=np.uint32)
    bits |= np.ascontiguousarray(values).view(np.uint32)
    return bits.view(np.float32)


def flagged(where: Mask, reason: Invalid) -> NDArray[np.uint16]:
    """Return a reason where it holds, else 0."""
    return np.multiply(where, np.uint16(reason), dtype=np.uint16)


@dataclass(frozen=True)
class Disparity:
    """A disparity map of the left image.

    Attributes
    ----------
    disparity_px : float32 (H, W)
        Left column minus right column, px; NaN where invalid.
    validity : uint16 (H, W)
        `Invalid` flags; 0 where valid.
    confidence : float32 (H, W) or None
        Predicted probability that the error is below 1 px, 0-1.
    sigma_px : float32 (H, W) or None
        Predicted standard deviation of the disparity, px.
    right_px : float32 (H, W) or None
        Disparity of the right image (same sign convention, indexed by right column), for consistency checks.
    excess : float32 (H, W) or None
        How much the second best cost exceeds the best one, relative to it, where the matcher knows; NaN where the cost
        is flat. Evidence for the confidence, not a probability.
    merit : float or None
        Predicted share of the wanted pixels that are right within 1 px, 0-1: orders the maps of one pair.
    """

    disparity_px: FloatImage
    validity: NDArray[np.uint16]
    confidence: FloatImage | None = None
    sigma_px: FloatImage | None = None
    right_px: FloatImage | None = None
    excess: FloatImage | None = None
    merit: float | None = None

    @property
    def valid(self) -> Mask:
        """True where the pixel has a disparity."""
        return np.isfinite(self.disparity_px)

    def reject(self, where: Mask, reason: Invalid) -> Disparity:
        """Return a copy with the valid pixels of `where` made invalid for `reason`."""
        drop = where & self.valid
        return replace(
            self, disparity_px=blanked(self.disparity_px, drop), validity=self.validity | flagged(drop, reason)
        )

    def rejected(self) -> dict[str, int]:
        """Count the invalid pixels by reason."""
        counts = {flag.name or "": int(np.count_nonzero(self.validity & flag.value)) for flag in Invalid}
        return {name: count for name, count in counts.items() if count}


@dataclass(frozen=True)
class Matching:
    """State of the matching stage: what its operators take and return.

    `filled` is a product beside the disparity, for display: its filled pixels have a value, `Invalid.FILLED` and no
    confidence. Nothing is reconstructed from it.
    """

    views: Views
    range_px: DisparityRange | None = None
    disparity: Disparity | None = None
    filled: Disparity | None = None
