"""Images in and out, RGB in memory whatever the file holds."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.formats._text import write_bytes
from modules.formats.errors import FormatError
from modules.types import Image

MIN_SIDE_PX = 16
MAX_PIXELS = 100_000_000
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_SIGNATURE = b"\xff\xd8\xff"


def read_image(path: Path | str) -> Image:
    """Read an image file.

    Parameters
    ----------
    path : Path or str
        PNG, JPEG, TIFF, PGM, PPM or BMP; gray, RGB or with alpha (dropped); 8 or 16 bit.

    Returns
    -------
    Image
        (H, W) gray or (H, W, 3) RGB, uint8 or uint16 as stored.

    Raises
    ------
    FormatError
        When the file is missing, no image, truncated, smaller than 16 px a side, larger than 100 megapixels, or of
        another depth.
    """
    path = Path(path)
    content = _content(path)
    _check_whole(path, content)
    _check_size(path, _stated_size(content))
    try:
        decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise FormatError(f"{path} cannot be decoded ({error.err}); export it again as PNG") from error
    if decoded is None:
        raise FormatError(f"{path} is not an image that can be read; use PNG, JPEG, TIFF or PGM")
    _check_size(path, (decoded.shape[1], decoded.shape[0]))
    if decoded.dtype == np.uint8:
        return _as_rgb(path, decoded.astype(np.uint8, copy=False))
    if decoded.dtype == np.uint16:
        return _as_rgb(path, decoded.astype(np.uint16, copy=False))
    raise FormatError(f"{path} holds {decoded.dtype} values; convert it to 8 or 16 bit without sign")


def write_image(path: Path | str, image: Image) -> None:
    """Write a gray or RGB image of 8 or 16 bit; the suffix gives the format.

    Raises
    ------
    FormatError
        For another shape or depth, an unknown suffix, or a path that cannot be written.
    """
    path = Path(path)
    if (
        image.dtype not in (np.uint8, np.uint16)
        or image.ndim not in (2, 3)
        or (image.ndim == 3 and image.shape[2] != 3)
    ):
        raise FormatError(
            f"{path}: an image is (H, W) or (H, W, 3) of uint8 or uint16, not {image.shape} {image.dtype}"
        )
    stored: NDArray[np.integer[Any]] = image if image.ndim == 2 else image[:, :, ::-1].copy()
    try:
        good, encoded = cv2.imencode(path.suffix or ".", stored)
    except cv2.error as error:
        raise FormatError(f"{path}: images cannot be written as '{path.suffix}'; use .png") from error
    if not good:
        raise FormatError(f"{path}: the image could not be encoded as '{path.suffix}'; use .png")
    write_bytes(path, encoded.tobytes())


def _as_rgb(path: Path, decoded: Image) -> Image:
    """Return gray (H, W) or RGB (H, W, 3) of what OpenCV decoded."""
    if decoded.ndim == 2:
        return decoded
    channels = decoded.shape[2]
    if channels == 1:
        return decoded[:, :, 0]
    if channels not in (3, 4):
        raise FormatError(f"{path} has {channels} channels; 1 (gray), 3 (RGB) or 4 (RGB and alpha) are possible")
    return decoded[:, :, 2::-1].copy()


def _content(path: Path) -> bytes:
    if not path.exists():
        raise FormatError(f"{path} does not exist; check the path of the image")
    if path.is_dir():
        raise FormatError(f"{path} is a folder; give the image file inside it")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check its permissions") from error
    if not content:
        raise FormatError(f"{path} is empty (0 bytes); copy it again")
    return content


def _check_whole(path: Path, content: bytes) -> None:
    """Refuse PNG and JPEG files that end early: the decoder fills the rest with gray and says nothing."""
    if content.startswith(PNG_SIGNATURE):
        _check_png(path, content)
    elif content.startswith(JPEG_SIGNATURE) and b"\xff\xd9" not in content[-4096:]:
        raise FormatError(f"{path} is truncated: {len(content)} bytes without the end mark of a JPEG; copy it again")


def _check_png(path: Path, content: bytes) -> None:
    import zlib

    position = len(PNG_SIGNATURE)
    while position + 12 <= len(content):
        (length,) = struct.unpack(">I", content[position : position + 4])
        end = position + 12 + length
        if end > len(content):
            break
        kind = content[position + 4 : position + 8]
        (stated,) = struct.unpack(">I", content[end - 4 : end])
        if zlib.crc32(content[position + 4 : end - 4]) != stated:
            raise FormatError(f"{path} is damaged: chunk {kind!r} at byte {position} fails its checksum; copy it again")
        if kind == b"IEND":
            return
        position = end
    raise FormatError(f"{path} is truncated: {len(content)} bytes without the end mark of a PNG; copy it again")


def _stated_size(content: bytes) -> tuple[int, int] | None:
    """Return width and height of a PNG or JPEG header, so that a bomb is refused before it is decoded."""
    if content.startswith(PNG_SIGNATURE) and len(content) >= 24:
        width, height = struct.unpack(">II", content[16:24])
        return width, height
    if content.startswith(JPEG_SIGNATURE):
        position = 2
        while position + 9 <= len(content) and content[position] == 0xFF:
            kind = content[position + 1]
            if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
                height, width = struct.unpack(">HH", content[position + 5 : position + 9])
                return width, height
            (length,) = struct.unpack(">H", content[position + 2 : position + 4])
            position += 2 + length
    return None


def _check_size(path: Path, size: tuple[int, int] | None) -> None:
    if size is None:
        return
    width, height = size
    if min(width, height) < MIN_SIDE_PX:
        raise FormatError(
            f"{path} is {width}x{height} px and needs at least {MIN_SIDE_PX} px a side; give a larger image"
        )
    if width * height > MAX_PIXELS:
        raise FormatError(
            f"{path} is {width}x{height} px, above the limit of {MAX_PIXELS // 1_000_000} megapixels; "
            "reduce or crop the pair first"
        )
