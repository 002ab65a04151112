"""Remove a gain and an offset between the surfaces beside corresponding edges."""

from __future__ import annotations

from typing import Literal, cast

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.photometry import apply_tables, to_8_bit, to_gray
from modules.primitives.segments import find_segments, match_segments, sample_beside
from modules.primitives.statistics import Floats, fit_linear
from modules.types import FloatImage, Image, Views, dn_scale, full_scale

WIDTH_PX = 400  # of the copies in which segments are found
SEARCH = (-0.25, 0.45)  # disparities searched, fractions of the width; negative: swapped or toed in
BESIDE_PX = np.array([[-4, -3, -2], [2, 3, 4]])  # columns sampled to the left and to the right of an edge
LEAST_SAMPLES = 16
CLIP_DN = 4.0  # samples this near to 0 or full scale say little about the response
SCALE_DN = 1.0  # least spread of the residuals assumed, dn
GAIN_LIMIT = 20.0


class CalibrateSegmentsParams(OperatorParams):
    """Parameters of `calibrate_segments`."""

    reference: Literal["left", "right"] = Field("left", description="Image that stays as it is")
    channels: Literal["gray", "each"] = Field("each", description="One fit for all channels, or one per channel")


def calibrate_segments(views: Views, params: CalibrateSegmentsParams) -> Views:
    """Fit `reference = gain * image + offset` to the intensities on both sides of corresponding edge segments.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : CalibrateSegmentsParams

    Returns
    -------
    Views
        Images of the same shape and dtype, clipped to the range of the dtype and rounded to nearest.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype, fewer than 16 samples beside segments correspond, or the gain lies
        outside 0.05 to 20.

    Notes
    -----
    Edges can be found and matched whatever the brightness, and the surfaces beside them are seen by both cameras. The
    side that belongs to the background may differ between the images; the robust fit leaves such samples out. After the
    idea of Kawai and Tomita; detection, matching and fit are this project's.

    References
    ----------
    After Y. Kawai and F. Tomita, Intensity calibration for stereo images based on segment correspondence, IAPR Workshop
    on Machine Vision Applications, 1998; J. Canny, A computational approach to edge detection, IEEE TPAMI 8(6), 1986.
    """
    name = "correction.calibrate_segments"
    check_pair(views, name)
    left, right = (_reduced(image) for image in (views.left, views.right))
    samples = _samples(left, right)
    source, target = samples[::-1] if params.reference == "left" else samples
    if params.channels == "gray":
        source, target = source.mean(axis=1, keepdims=True), target.mean(axis=1, keepdims=True)
    top = full_scale(views.left)
    scale = dn_scale(views.left)
    tables = []
    for channel in range(source.shape[1]):
        gain, offset = _fit(source[:, channel], target[:, channel], name)
        tables.append(np.clip(gain * np.arange(top + 1) + offset * scale, 0, top))
    if params.reference == "left":
        return views.with_images(views.left, apply_tables(views.right, tables))
    return views.with_images(apply_tables(views.left, tables), views.right)


def _reduced(image: Image) -> Image:
    factor = min(1.0, WIDTH_PX / image.shape[1])
    if factor == 1.0:
        return image
    return cast(Image, cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA))


def _samples(left: Image, right: Image) -> tuple[Floats, Floats]:
    """Return the values in DN beside corresponding segments of both images, each (2 M, C)."""
    segments = [find_segments(to_8_bit(to_gray(image))) for image in (left, right)]
    width = left.shape[1]
    pairs = match_segments(segments[0], segments[1], SEARCH[0] * width, SEARCH[1] * width)
    columns = [side.columns[pairs[:, index]] for index, side in enumerate(segments)]
    shared = np.isfinite(columns[0]) & np.isfinite(columns[1])
    sides = [_beside(image, np.where(shared, x, np.nan)) for image, x in zip((left, right), columns, strict=True)]
    return sides[0], sides[1]


def _beside(image: Image, columns: FloatImage) -> Floats:
    planes = image[..., None] if image.ndim == 2 else image
    scale = np.float32(dn_scale(image))
    values: list[NDArray[np.float32]] = []
    for offsets in BESIDE_PX:
        channels = [
            sample_beside(planes[..., channel].astype(np.float32) / scale, columns, offsets).mean(axis=1)
            for channel in range(planes.shape[2])
        ]
        values.append(np.stack(channels, axis=1))
    return np.concatenate(values).astype(np.float64)


def _fit(source: Floats, target: Floats, name: str) -> tuple[float, float]:
    use = (np.minimum(source, target) >= CLIP_DN) & (np.maximum(source, target) <= 255 - CLIP_DN)
    if np.count_nonzero(use) < LEAST_SAMPLES:
        raise OperatorError(
            f"{name}: {np.count_nonzero(use)} samples beside corresponding edges, {LEAST_SAMPLES} are needed; use "
            "correction.match_histograms, which needs no edges"
        )
    design = np.stack([source[use], np.ones(int(use.sum()))], axis=1)
    (gain, offset), _, _ = fit_linear(design, target[use], SCALE_DN)
    if not 1 / GAIN_LIMIT <= gain <= GAIN_LIMIT:
        raise OperatorError(
            f"{name}: fitted gain {gain:.3g} is outside {1 / GAIN_LIMIT:g} to {GAIN_LIMIT:g}; use "
            "correction.match_histograms"
        )
    return float(gain), float(offset)


OPERATOR = Operator(
    name="correction.calibrate_segments",
    slot="radiometry",
    params=CalibrateSegmentsParams,
    function=calibrate_segments,
    cost=Cost(fixed_ms=24.0, ns_per_pixel=15),
    summary="Fits a gain and an offset to the surfaces beside corresponding edges and undoes them in one image.",
    suits="Exposure differences of scenes with clear edges, contents that differ included; not response curves.",
)
