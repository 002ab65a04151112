"""Disparity and validity files: PFM and 16-bit PNG."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.formats._text import write_bytes
from modules.formats.errors import FormatError
from modules.formats.images import MAX_PIXELS, _content, read_image, write_image
from modules.types import FloatImage

PNG_SCALE = 256.0  # stored value / 256 = disparity in px; 0 is invalid
PNG_MAX_PX = 65535.0 / PNG_SCALE


def write_pfm(path: Path | str, disparity_px: FloatImage) -> None:
    """Write a gray PFM, little endian, bottom row first; NaN becomes infinity, the Middlebury mark for invalid."""
    values = np.where(np.isfinite(disparity_px), disparity_px, np.inf).astype("<f4")
    height, width = values.shape
    header = f"Pf\n{width} {height}\n-1.0\n".encode("ascii")
    write_bytes(Path(path), header + values[::-1].tobytes())


def read_pfm(path: Path | str) -> FloatImage:
    """Read a gray PFM; infinities become NaN.

    Returns
    -------
    float32 (H, W)

    Raises
    ------
    FormatError
        When the file is missing, no gray PFM, too large or of another length than its header says.
    """
    return parse_pfm(str(path), _content(Path(path)))


def parse_pfm(name: str, content: bytes) -> FloatImage:
    """Read the content of a gray PFM as `read_pfm` does; `name` is for messages.

    Raises
    ------
    FormatError
        As `read_pfm`.
    """
    header = re.match(rb"Pf\s+(\d+)\s+(\d+)\s+(-?[\d.]+(?:[eE][-+]?\d+)?)\s", content)
    if header is None:
        raise FormatError(f"{name} does not begin like a gray PFM ('Pf', width and height, scale); give a PFM file")
    width, height, scale = int(header[1]), int(header[2]), float(header[3])
    if width * height > MAX_PIXELS or width * height == 0:
        raise FormatError(f"{name} is {width}x{height} px; 1 to {MAX_PIXELS} px are possible, crop it")
    data = content[header.end() :]
    if len(data) != 4 * width * height:
        raise FormatError(
            f"{name} holds {len(data)} bytes of data and {width}x{height} px need {4 * width * height}; copy it again"
        )
    values = np.frombuffer(data, "<f4" if scale < 0 else ">f4").reshape(height, width)[::-1].astype(np.float32)
    return np.where(np.isfinite(values), values, np.float32(np.nan))


def write_disparity_png(path: Path | str, disparity_px: FloatImage) -> None:
    """Write a 16-bit PNG in steps of 1/256 px, 0 where invalid.

    Raises
    ------
    FormatError
        When a disparity is below 1/512 px (it would read as invalid) or above 255.99 px.
    """
    valid = np.isfinite(disparity_px)
    steps = np.rint(np.where(valid, disparity_px, 0.0).astype(np.float64) * PNG_SCALE)
    outside = valid & ((steps < 1) | (steps > 65535))
    if outside.any():
        found = disparity_px[outside]
        raise FormatError(
            f"{path}: {len(found)} disparities from {found.min():g} to {found.max():g} px lie outside the 16-bit PNG "
            f"range of {1 / PNG_SCALE:.4f} to {PNG_MAX_PX:.2f} px; write a PFM"
        )
    write_image(path, steps.astype(np.uint16))


def read_disparity_png(path: Path | str) -> FloatImage:
    """Read a 16-bit PNG in steps of 1/256 px; 0 becomes NaN.

    Raises
    ------
    FormatError
        As `read_image`, and for a PNG that is not 16-bit gray.
    """
    stored = read_image(path)
    if stored.dtype != np.uint16 or stored.ndim != 2:
        raise FormatError(f"{path} is {stored.dtype} with shape {stored.shape}; a disparity PNG is 16-bit gray")
    return np.where(stored == 0, np.nan, stored / PNG_SCALE).astype(np.float32)


def write_validity_png(path: Path | str, validity: NDArray[np.uint16]) -> None:
    """Write the `Invalid` flags of every pixel as a 16-bit PNG; 0 is valid."""
    write_image(path, validity.astype(np.uint16))


def read_validity_png(path: Path | str) -> NDArray[np.uint16]:
    """Read the flags that `write_validity_png` wrote."""
    stored = read_image(path)
    if stored.dtype != np.uint16 or stored.ndim != 2:
        raise FormatError(f"{path} is {stored.dtype} with shape {stored.shape}; a validity PNG is 16-bit gray")
    return stored.astype(np.uint16)


def view_range_px(disparity_px: FloatImage) -> tuple[float, float]:
    """Return what the ends of the colours of a disparity view stand for: the 1st and 99th percentile, px."""
    valid = disparity_px[np.isfinite(disparity_px)]
    low, high = np.percentile(valid, [1.0, 99.0]) if valid.size else (0.0, 1.0)
    return float(low), float(high)


def write_disparity_view(path: Path | str, disparity_px: FloatImage) -> None:
    """Write a colour picture for people: Turbo over `view_range_px`, black where invalid."""
    valid = np.isfinite(disparity_px)
    low, high = view_range_px(disparity_px)
    scaled = np.clip((np.where(valid, disparity_px, low) - low) / max(high - low, 1e-6), 0.0, 1.0)
    colours = cv2.applyColorMap(np.rint(scaled * 255).astype(np.uint8), cv2.COLORMAP_TURBO)[:, :, ::-1]
    write_image(path, np.where(valid[..., None], colours, 0).astype(np.uint8))


def write_confidence_png(path: Path | str, confidence: FloatImage) -> None:
    """Write the probability that a disparity is right as an 8-bit PNG, 255 for certain; 0 also where there is none."""
    write_image(path, np.rint(np.nan_to_num(confidence) * 255.0).clip(0, 255).astype(np.uint8))
