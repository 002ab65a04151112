"""What the image to correct and its reference show at the same points, at low resolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.operator import OperatorError
from modules.primitives.coarse import coarse_match
from modules.primitives.photometry import to_8_bit, to_gray
from modules.types import FloatImage, Image, Mask, Views, dn_scale

SEARCH = (-0.25, 0.45)  # disparities searched, fractions of the width; negative: swapped or toed in
WIDTH_PX = 200
CLIP_DN = 4.0  # values this near to 0 or full scale say little about the response


@dataclass(frozen=True)
class Corresponding:
    """Thumbnails of the image to correct, and of the reference as seen from it.

    Attributes
    ----------
    source, reference : float32 (h, w, C)
        Values in DN at the same points of the scene, where `valid`.
    valid : bool (h, w)
        Matched, unmasked and clipped in neither image.
    """

    source: FloatImage
    reference: FloatImage
    valid: Mask


def corresponding(views: Views, reference: Literal["left", "right"], name: str) -> Corresponding:
    """Match thumbnails of a pair densely and bring the reference to the geometry of the other image.

    Raises
    ------
    OperatorError
        If hardly anything matches.
    """
    # The coarse match refers to its left image; mirrored and swapped, the right image is one.
    mirrored = reference == "left"
    source, other = (views.right, views.left) if mirrored else (views.left, views.right)
    masks = (views.right_mask, views.left_mask) if mirrored else (views.left_mask, views.right_mask)
    planes = [_mirror(to_8_bit(to_gray(image)), mirrored) for image in (source, other)]
    width = views.shape[1]
    match = coarse_match(planes[0], planes[1], SEARCH[0] * width, SEARCH[1] * width, WIDTH_PX)
    if match is None:
        raise OperatorError(
            f"{name}: the images of {width}x{views.shape[0]} px have hardly any corresponding points; use an operator "
            "that compares histograms instead, correction.match_histograms"
        )
    disparity = match.visible()
    size = (disparity.shape[1], disparity.shape[0])
    thumbnails = [_mirror(_thumbnail(image, size), mirrored) for image in (source, other)]
    v, u = np.mgrid[0 : size[1], 0 : size[0]].astype(np.float32)
    matched = np.isfinite(disparity)
    columns = u - np.where(matched, disparity, np.float32(0))
    seen = cv2.remap(thumbnails[1], columns, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen = np.asarray(seen, dtype=np.float32).reshape(thumbnails[0].shape)
    valid = matched & _within(thumbnails[0]) & _within(seen)
    if masks[0] is not None:
        valid &= _mirror(_shrunk(masks[0], size), mirrored)
    if masks[1] is not None:
        usable = _mirror(_shrunk(masks[1], size), mirrored).astype(np.float32)
        valid &= np.asarray(cv2.remap(usable, columns, v, cv2.INTER_NEAREST)) > 0
    return Corresponding(_mirror(thumbnails[0], mirrored), _mirror(seen, mirrored), _mirror(valid, mirrored))


def _mirror(array: NDArray, mirrored: bool) -> NDArray:
    return np.ascontiguousarray(array[:, ::-1]) if mirrored else array


def _thumbnail(image: Image, size: tuple[int, int]) -> FloatImage:
    """Return an image in DN at another size, float32 (h, w, C)."""
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA)).astype(np.float32)
    small /= np.float32(dn_scale(image))
    return small if small.ndim == 3 else small[..., None]


def _shrunk(mask: Mask, size: tuple[int, int]) -> Mask:
    return np.asarray(cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)) > 0


def _within(values: FloatImage) -> Mask:
    return np.asarray((values.min(axis=2) >= CLIP_DN) & (values.max(axis=2) <= 255 - CLIP_DN))
