"""Pictures and curves of a report, made from the bytes of the files of a run; pure functions."""

from __future__ import annotations

import base64
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.types import Image, full_scale

FILES = (
    "left_original.png",
    "right_original.png",
    "left_corrected.png",
    "right_corrected.png",
    "validity.png",
    "disparity_view.png",
    "disparity.pfm",
    "confidence.png",
    "ortho.png",
    "layers.npz",
    "terrain.html",
)
"""Files of a run that the report shows or links; the originals are there only where the correction changed them."""

MAX_SIDE_PX = 1000
MAX_BYTES = 450_000  # of one picture, so that the whole report stays below 8 MB
JPEG_QUALITIES = (85, 60)
PNG_SIGNATURE, PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
BINS = 64
THUMBNAIL_PX = 320
PLOT_WIDTH, PLOT_HEIGHT = 256, 100


@dataclass(frozen=True)
class Picture:
    """A picture as it stands in the page: a data URI and its size in px."""

    uri: str
    width: int
    height: int


@dataclass(frozen=True)
class Curve:
    """Histograms of one channel of both images as points of SVG polylines."""

    channel: str
    left: str
    right: str
    left_mean_dn: float
    right_mean_dn: float


def decode(name: str, content: bytes) -> Image:
    """Decode a PNG to gray or RGB.

    Raises
    ------
    ValueError
        The bytes are no image of 8 or 16 bit.
    """
    decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    if decoded is None or decoded.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{name} is not an image of 8 or 16 bit; run the pair again")
    if decoded.ndim == 3:
        decoded = np.ascontiguousarray(decoded[:, :, 2::-1])
    return cast(Image, decoded)


def _eight_bit(image: Image) -> NDArray[np.uint8]:
    if image.dtype == np.uint8:
        return image.astype(np.uint8, copy=False)
    return np.rint(image / (full_scale(image) / 255.0)).astype(np.uint8)


def _packed(kind: str, content: bytes, shape: tuple[int, ...]) -> Picture:
    return Picture(f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}", shape[1], shape[0])


def picture(image: Image, *, photo: bool) -> Picture:
    """Pack an image as JPEG (photographs) or PNG (drawings), smaller than `MAX_SIDE_PX` and `MAX_BYTES`.

    A drawing that is too large goes in as JPEG. What is still too large is shown at half its size.
    """
    small = _eight_bit(image)
    height, width = small.shape[:2]
    scale = MAX_SIDE_PX / max(height, width)
    if scale < 1:
        small = _resized(small, scale)
        photo = True
    stored = small[:, :, ::-1] if small.ndim == 3 else small
    if not photo:
        content = cv2.imencode(".png", stored)[1].tobytes()
        if len(content) <= MAX_BYTES:
            return _packed("png", content, small.shape)
    for quality in JPEG_QUALITIES:
        content = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        if len(content) <= MAX_BYTES:
            return _packed("jpeg", content, small.shape)
    return picture(_resized(small, 0.5), photo=True)


def _resized(image: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    return cast("NDArray[np.uint8]", cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def drawing(name: str, content: bytes) -> Picture:
    """Pack a PNG as it is where it is small enough, otherwise like `picture`.

    Raises
    ------
    ValueError
        It is no image.
    """
    width, height = _png_size(content)
    if 0 < max(width, height) <= MAX_SIDE_PX and len(content) <= MAX_BYTES:
        return _packed("png", content, (height, width))
    return picture(decode(name, content), photo=False)


def thumbnail(name: str, content: bytes) -> Picture:
    """Return a PNG no wider than `THUMBNAIL_PX`.

    Raises
    ------
    ValueError
        It is no image.
    """
    image = _eight_bit(decode(name, content))
    scale = THUMBNAIL_PX / image.shape[1]
    return picture(_resized(image, scale) if scale < 1 else image, photo=True)


def _png_size(content: bytes) -> tuple[int, int]:
    """Return width and height of a whole PNG; 0 of anything else."""
    if not content.startswith(PNG_SIGNATURE) or not content.endswith(PNG_END):
        return 0, 0
    width, height = struct.unpack(">II", content[16:24])
    return width, height


def _channels(image: Image) -> dict[str, Image]:
    if image.ndim == 2:
        return {"gray": image}
    return {name: image[:, :, index] for index, name in enumerate(("red", "green", "blue"))}


def _levels(channel: Image) -> NDArray[np.int64]:
    return np.bincount(_eight_bit(channel).ravel(), minlength=256).astype(np.int64)


def _points(counts: NDArray[np.float64], top: float) -> str:
    step = PLOT_WIDTH / BINS
    heights = PLOT_HEIGHT * (1.0 - np.minimum(counts / top, 1.0))
    return " ".join(f"{(index + 0.5) * step:g},{height:.1f}" for index, height in enumerate(heights))


def histograms(left: Image, right: Image) -> list[Curve]:
    """Return the histograms of both images per channel, on one scale so that they can be compared.

    The scale ends at the second largest bin times 1.25, so that a clipped end does not flatten the rest.
    """
    curves = []
    pairs = zip(_channels(left).items(), _channels(right).values(), strict=False)
    for (name, one), other in pairs:
        levels = _levels(one), _levels(other)
        counts = [found.reshape(BINS, -1).sum(axis=1) / found.sum() for found in levels]
        top = max(1.25 * float(np.sort(np.stack(counts), axis=1)[:, -2].max()), 1e-6)
        left_mean, right_mean = (float(found @ np.arange(256) / found.sum()) for found in levels)
        curves.append(Curve(name, _points(counts[0], top), _points(counts[1], top), left_mean, right_mean))
    return curves


@dataclass(frozen=True)
class Wipe:
    """One image of the pair before and after the correction; `before` is None where nothing was changed."""

    side: str
    before: Picture | None
    after: Picture


@dataclass(frozen=True)
class PairPictures:
    """The pair before and after correction, and the histograms of both images."""

    wipes: tuple[Wipe, ...] = ()
    before: tuple[Curve, ...] = ()
    after: tuple[Curve, ...] = ()


def pair_pictures(files: Mapping[str, bytes]) -> PairPictures:
    """Make the pictures and histograms of the pair; what the run did not write is left out.

    Raises
    ------
    ValueError
        A file is damaged.
    """
    before: dict[str, Image] = {}
    after: dict[str, Image] = {}
    wipes = []
    for side in ("left", "right"):
        if f"{side}_corrected.png" not in files:
            continue
        after[side] = decode(f"{side}_corrected.png", files[f"{side}_corrected.png"])
        name = f"{side}_original.png"
        before[side] = decode(name, files[name]) if name in files else after[side]
        shown = picture(before[side], photo=True) if name in files else None
        wipes.append(Wipe(side, shown, picture(after[side], photo=True)))
    if len(wipes) < 2:
        return PairPictures(tuple(wipes))
    curves = histograms(after["left"], after["right"])
    changed = any(wipe.before for wipe in wipes)
    earlier = histograms(before["left"], before["right"]) if changed else curves
    return PairPictures(tuple(wipes), tuple(earlier), tuple(curves))
