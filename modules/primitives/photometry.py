"""Gray, 8-bit and common-field-of-view versions of a pair."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.types import Image


def to_gray(image: Image) -> Image:
    """Return the luminance of an RGB or gray image, (H, W), same dtype (Rec. 601 weights)."""
    if image.ndim == 2:
        return image
    gray: Any = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cast(Image, gray)


def to_8_bit(image: Image) -> NDArray[np.uint8]:
    """Return the image on the 0-255 scale, uint8, rounded; 8-bit images are returned as they are."""
    if image.dtype == np.uint8:
        return image  # type: ignore[return-value]
    return np.asarray(cv2.convertScaleAbs(image, alpha=1 / 257.0)).reshape(image.shape).astype(np.uint8, copy=False)


def shrink(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Reduce an image to a size by averaging areas; by exact halves as far as they go.

    Exact halves take a tenth of the time of other factors. A last odd row or column is cut off before halving.

    Parameters
    ----------
    image : uint8 (H, W) or (H, W, 3)
    width, height : int
        Size wanted, px, no larger than the image.
    """
    while image.shape[1] >= 2 * width and image.shape[0] >= 2 * height:
        size = (image.shape[1] // 2, image.shape[0] // 2)
        even = image[: 2 * size[1], : 2 * size[0]]
        image = np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA), np.uint8)
    if image.shape[:2] == (height, width):
        return image
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def apply_table(image: Image, table: NDArray[np.float64]) -> Image:
    """Map every level of an image through a table over all levels of its dtype, rounded to nearest."""
    levels = np.clip(np.rint(table), 0, len(table) - 1)
    mapped: Image
    if image.dtype == np.uint8:
        mapped = np.asarray(cv2.LUT(image, levels.astype(np.uint8)), dtype=np.uint8).reshape(image.shape)
    else:
        mapped = levels.astype(np.uint16)[image]
    return mapped


def apply_tables(image: Image, tables: Sequence[NDArray[np.float64]]) -> Image:
    """Map an image through one table, or each colour channel through its own."""
    if len(tables) == 1 or image.ndim == 2:
        return apply_table(image, tables[0])
    if image.dtype == np.uint8:
        levels = np.clip(np.rint(np.stack(tables, axis=1)), 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(image, levels[None]), dtype=np.uint8)
    mapped = np.empty_like(image)
    for channel, table in enumerate(tables):
        plane = cast(Image, np.ascontiguousarray(image[..., channel]))
        mapped[..., channel] = apply_table(plane, table)
    return mapped


def dominant_shift_px(left: NDArray[np.uint8], right: NDArray[np.uint8], width: int = 96) -> int:
    """Estimate the column shift that brings most of the right image over the left one.

    Correlates locally normalised thumbnails over shifts of up to 40 % of the width in both directions. Good enough to
    compare what both images see; not a disparity.

    Parameters
    ----------
    left, right : uint8 (H, W)
    width : int
        Width of the thumbnails in px.

    Returns
    -------
    int
        Left column minus right column, px; 0 where nothing correlates.
    """
    height = max(8, round(left.shape[0] * width / left.shape[1]))
    if left.shape[1] < 2 * 8 or left.shape[0] < 8:
        return 0
    thumbnails = [
        np.asarray(cv2.resize(x, (width, height), interpolation=cv2.INTER_AREA), np.uint8) for x in (left, right)
    ]
    a, b = (standardise(image, window_px=9, damping_dn=2.0) for image in thumbnails)
    limit = int(0.4 * width)
    scores = _correlations(a, b, limit)
    best = int(np.argmax(scores))
    if scores[best] < 0.1:
        return 0
    return round((best - limit) * left.shape[1] / width)


def _correlations(left: NDArray[np.float32], right: NDArray[np.float32], limit: int) -> NDArray[np.float64]:
    """Return the normalised correlation of the overlap for every column shift from `-limit` to `limit`."""
    width = left.shape[1]
    spectrum = (np.fft.rfft(left, 2 * width, axis=1) * np.conj(np.fft.rfft(right, 2 * width, axis=1))).sum(axis=0)
    products = np.fft.irfft(spectrum, 2 * width)
    shifts = np.arange(-limit, limit + 1)
    left_sum, right_sum = (
        np.concatenate([[0.0], np.cumsum((x.astype(np.float64) ** 2).sum(axis=0))]) for x in (left, right)
    )
    first, last = np.maximum(shifts, 0), width + np.minimum(shifts, 0)  # columns of the left image that overlap
    energy = (left_sum[last] - left_sum[first]) * (right_sum[last - shifts] - right_sum[first - shifts])
    return np.asarray(products[shifts] / np.sqrt(np.maximum(energy, 1e-9)), dtype=np.float64)


def common_view(left: NDArray[Any], right: NDArray[Any], shift_px: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Cut both images to the columns they share when the scene is shifted by `shift_px` (left minus right column)."""
    width = left.shape[1]
    shift = int(np.clip(shift_px, -width + 1, width - 1))
    if shift >= 0:
        return left[:, shift:], right[:, : width - shift]
    return left[:, : width + shift], right[:, -shift:]


def seen_alone(left: NDArray[Any], right: NDArray[Any], shift_px: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Cut both images to the columns that `common_view` leaves out."""
    width = left.shape[1]
    shift = int(np.clip(shift_px, -width + 1, width - 1))
    if shift >= 0:
        return left[:, :shift], right[:, width - shift :]
    return left[:, width + shift :], right[:, :-shift]


def standardise(image: NDArray[np.uint8], window_px: int, damping_dn: float) -> NDArray[np.float32]:
    """Return `(g - mean) / (std + damping)` with square windows, float32 (H, W); immune to smooth changes of light.

    Parameters
    ----------
    image : uint8 (H, W)
    window_px : int
        Side of the window, odd.
    damping_dn : float
        Added to the local standard deviation; keeps noise small where there is no texture.
    """
    window = (window_px, window_px)
    mean = np.asarray(cv2.boxFilter(image, cv2.CV_32F, window), np.float32)
    square = np.multiply(image, image, dtype=np.uint16)
    spread = np.asarray(cv2.boxFilter(square, cv2.CV_32F, window), np.float32)
    spread -= mean * mean
    np.abs(spread, out=spread)  # rounding may leave it below 0
    cv2.sqrt(spread, spread)
    spread += np.float32(damping_dn)
    np.subtract(image.astype(np.float32), mean, out=mean)
    mean /= spread
    return mean


def standardise_to_bytes(image: NDArray[np.uint8], window_px: int, damping_dn: float) -> NDArray[np.uint8]:
    """Return `128 + 40 s` of the standardised image, rounded and clipped, uint8 (H, W), for matchers of bytes."""
    scaled = standardise(image, window_px, damping_dn)
    scaled *= np.float32(40)
    scaled += np.float32(128.5)
    return np.clip(scaled, 0, 255, out=scaled).astype(np.uint8)


def normalise_contrast(image: NDArray[Any], sigma_px: float, eps: float) -> NDArray[np.float32]:
    """Return `(g - mean_s) / (std_s + eps)` with Gaussian windows, float32, shape of the image.

    Parameters
    ----------
    image : (H, W) or (H, W, 3)
    sigma_px : float
        Standard deviation of the window, px. Windows of 8 px and more are evaluated on a copy reduced by up to a
        quarter of the deviation: mean and spread are smooth, and the cost no longer grows with the window.
    eps : float
        Added to the local standard deviation, in levels of the image; damps noise where there is no texture.
    """
    values = image.astype(np.float32)
    # Keeps the difference of squares accurate for 16 bit; a scalar would be added to the first channel only.
    centre = float(np.mean(cv2.mean(values)[: 1 if image.ndim == 2 else image.shape[2]]))
    centred = np.asarray(values - np.float32(centre), dtype=np.float32)
    mean, square = smooth(centred, sigma_px), smooth(centred * centred, sigma_px)
    spread = np.sqrt(np.maximum(square - mean * mean, 0))
    spread += np.float32(eps)
    centred -= mean
    centred /= spread
    return centred


def smooth(values: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Return the Gaussian mean of float32 (H, W) or (H, W, 3); borders are reflected.

    Deviations of 8 px and more are taken on a copy reduced by up to a quarter of the deviation and enlarged linearly;
    the result differs from the full one by a hundredth of the spread of the values, near borders by up to a tenth.
    """
    height, width = values.shape[:2]
    factor = min(int(sigma_px / 4), height // 8, width // 8)
    if factor < 2:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma_px), dtype=np.float32)
    size = (-(-width // factor), -(-height // factor))
    small = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
    # Averaging over the cell and interpolating between cells smooth too: a box and a triangle of the cell's width.
    own = (1 / 12 + 1 / 6) * factor**2
    blurred = cv2.GaussianBlur(small, (0, 0), float(np.sqrt(sigma_px**2 - own)) / factor)
    return np.asarray(cv2.resize(blurred, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def to_levels(values: NDArray[np.float32], gain: float, offset: float, like: Image) -> Image:
    """Return `gain * values + offset`, rounded to nearest (halves to even) and clipped to the dtype of `like`."""
    scaled = values * np.float32(gain)
    scaled += np.float32(offset)
    np.rint(scaled, out=scaled)
    top = np.iinfo(like.dtype).max
    limited = np.clip(scaled, 0, top, out=scaled)
    return cast(Image, limited.astype(like.dtype))
