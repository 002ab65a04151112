"""Checks and histograms that the operators of correction share."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np

from modules.operator import OperatorError
from modules.primitives.photometry import common_view, dominant_shift_px, to_8_bit, to_gray, to_levels
from modules.primitives.statistics import Floats, count_levels
from modules.types import FloatImage, Image, Mask, Views, full_scale

ROUNDING = 32 * float(np.finfo(np.float32).eps)  # relative, of a transform; the least step of 16 bits is twice that


def check_pair(views: Views, name: str) -> None:
    """Raise `OperatorError` unless both images have one shape and one dtype, uint8 or uint16."""
    left, right = views.left, views.right
    if left.shape != right.shape:
        raise OperatorError(
            f"{name}: left image is {left.shape} and right image is {right.shape}; crop them to one size first"
        )
    if left.dtype != right.dtype or left.dtype not in (np.uint8, np.uint16):
        raise OperatorError(
            f"{name}: images are {left.dtype} and {right.dtype}; convert both to uint8 or both to uint16 first"
        )


def shared_shift_px(views: Views) -> int:
    """Return the column shift between the contents of the images, px."""
    return dominant_shift_px(to_8_bit(to_gray(views.left)), to_8_bit(to_gray(views.right)))


def channel_histograms(views: Views, shift_px: int, channels: str) -> tuple[list[Floats], list[Floats]]:
    """Return the histograms of the left and right image, one per channel or one of luminance, on the common view."""
    sides: list[list[Floats]] = []
    left, right = views.left, views.right
    left_mask, right_mask = _mask(views.left_mask, views), _mask(views.right_mask, views)
    left_cut, right_cut = common_view(left, right, shift_px)
    left_use, right_use = common_view(left_mask, right_mask, shift_px)
    for name, image, use in (("left", left_cut, left_use), ("right", right_cut, right_use)):
        if not use.any():
            raise OperatorError(f"correction: no pixel of the {name} image is unmasked; loosen the masks first")
        counted = image if channels == "each" else to_gray(np.ascontiguousarray(image))
        sides.append(_count_channels(counted, None if use.all() else use))
    return sides[0], sides[1]


def _count_channels(image: Image, use: Mask | None) -> list[Floats]:
    """Return the histogram of each channel, or of a gray image, over the pixels of `use`."""
    if image.dtype != np.uint8:
        return [count_levels(plane if use is None else plane[use]) for plane in planes_of(image)]
    mask = None if use is None else use.astype(np.uint8)
    channels = range(1 if image.ndim == 2 else image.shape[2])
    found = (cv2.calcHist([image], [channel], mask, [256], [0, 256]) for channel in channels)
    return [np.asarray(counts, dtype=np.float64).ravel() for counts in found]


def planes_of(image: Image) -> list[Image]:
    """Return the channels of an image, each contiguous; one for a gray image."""
    if image.ndim == 2:
        return [image]
    return [cast(Image, np.ascontiguousarray(image[..., channel])) for channel in range(image.shape[2])]


def _mask(mask: Mask | None, views: Views) -> Mask:
    return np.ones(views.shape, bool) if mask is None else mask


def rescale_jointly(left: FloatImage, right: FloatImage, like: Image, name: str) -> tuple[Image, Image]:
    """Bring two results to the dtype of `like` by one range, so that equal values stay equal.

    The 0.5th and 99.5th percentile of both together become 0 and full scale; what lies beyond is clipped.

    Raises
    ------
    OperatorError
        If the values do not vary by more than a transform in float32 rounds, which differs by processor.
    """
    sample = np.concatenate([image[::3, ::3].ravel() for image in (left, right)])
    low, high = np.percentile(sample, (0.5, 99.5))
    if not high - low > ROUNDING * max(abs(low), abs(high)):
        raise OperatorError(
            f"{name}: both images have the one value {float(low):.4g} after filtering, two are needed; "
            "a constant image cannot be corrected"
        )
    gain = full_scale(like) / float(high - low)
    return to_levels(left, gain, -gain * float(low), like), to_levels(right, gain, -gain * float(low), like)
