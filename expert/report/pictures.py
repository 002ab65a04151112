"""Pictures and curves of a report, made from the bytes of the files of a run; pure functions."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.types import Image, Invalid, full_scale

PICTURES = (
    "left_original.png",
    "right_original.png",
    "left_corrected.png",
    "right_corrected.png",
    "validity.png",
    "disparity_view.png",
    "elevation.png",
)
"""Files of a run that the report shows; the originals are there only where the correction changed them."""

MAX_SIDE_PX = 1000
MAX_PNG_BYTES = 1_000_000  # above this a picture goes in as JPEG, which keeps the whole report below 8 MB
JPEG_QUALITY = 85
BINS = 64
PLOT_WIDTH, PLOT_HEIGHT = 256, 100

REASONS = {
    Invalid.NO_MATCH: "the matcher gave no disparity",
    Invalid.MASKED: "excluded by a mask of the pair",
    Invalid.OUTSIDE: "its match would lie outside the right image",
    Invalid.RANGE_BORDER: "best disparity at an end of the searched range",
    Invalid.LEFT_RIGHT: "the match of the match is another pixel",
    Invalid.NOT_UNIQUE: "a second disparity is nearly as good",
    Invalid.FLAT_MINIMUM: "the cost hardly depends on the disparity",
    Invalid.SPECKLE: "part of a small island",
    Invalid.SATURATED: "clipped in either image",
    Invalid.TEXTURELESS: "too little texture to decide",
    Invalid.LOW_CONFIDENCE: "below the confidence limit",
    Invalid.SKY: "sky, no terrain",
    Invalid.FILLED: "interpolated",
}


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


@dataclass(frozen=True)
class Share:
    """How many pixels have a flag."""

    flag: str
    meaning: str
    count: int
    percent: float


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
    """Scale an image down to `MAX_SIDE_PX` and pack it as JPEG (photographs) or PNG (drawings)."""
    small = _eight_bit(image)
    height, width = small.shape[:2]
    scale = MAX_SIDE_PX / max(height, width)
    if scale < 1:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        small = cast("NDArray[np.uint8]", cv2.resize(small, size, interpolation=cv2.INTER_AREA))
    stored = small[:, :, ::-1] if small.ndim == 3 else small
    if not photo:
        content = cv2.imencode(".png", stored)[1].tobytes()
        if len(content) <= MAX_PNG_BYTES:
            return _packed("png", content, small.shape)
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    return _packed("jpeg", cv2.imencode(".jpg", stored, quality)[1].tobytes(), small.shape)


def drawing(content: bytes, image: Image) -> Picture:
    """Pack a PNG as it is where it is small enough, otherwise like `picture`."""
    if max(image.shape[:2]) <= MAX_SIDE_PX and len(content) <= MAX_PNG_BYTES:
        return _packed("png", content, image.shape)
    return picture(image, photo=False)


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


def validity_shares(validity: Image) -> tuple[Share, list[Share]]:
    """Return the share of valid pixels, and of every flag that occurs, most frequent first.

    A pixel may have several flags.
    """
    total = validity.size
    valid = int((validity == 0).sum())
    shares = [
        Share(flag.name or "", REASONS[flag], count, 100.0 * count / total)
        for flag in Invalid
        if (count := int(((validity & int(flag)) != 0).sum()))
    ]
    return Share("VALID", "has a disparity", valid, 100.0 * valid / total), sorted(shares, key=lambda item: -item.count)


@dataclass(frozen=True)
class Wipe:
    """One image of the pair before and after the correction; `before` is None where nothing was changed."""

    side: str
    before: Picture | None
    after: Picture


@dataclass(frozen=True)
class Gallery:
    """All pictures of a report; what the run did not make is None or empty."""

    wipes: tuple[Wipe, ...]
    before: tuple[Curve, ...]
    after: tuple[Curve, ...]
    valid: Share | None
    reasons: tuple[Share, ...]
    disparity: Picture | None
    elevation: Picture | None


def gallery(images: Mapping[str, bytes]) -> Gallery:
    """Make everything a report shows from the files of a run.

    Raises
    ------
    ValueError
        A file is damaged.
    """
    decoded = {name: decode(name, images[name]) for name in PICTURES if name in images}
    before: dict[str, Image] = {}
    wipes = []
    for side in ("left", "right"):
        after = decoded.get(f"{side}_corrected.png")
        if after is None:
            continue
        original = decoded.get(f"{side}_original.png")
        before[side] = after if original is None else original
        shown = None if original is None else picture(original, photo=True)
        wipes.append(Wipe(side, shown, picture(after, photo=True)))
    curves: tuple[list[Curve], list[Curve]] = ([], [])
    if len(wipes) == 2:
        corrected = decoded["left_corrected.png"], decoded["right_corrected.png"]
        curves = histograms(before["left"], before["right"]), histograms(*corrected)
    valid, reasons = validity_shares(decoded["validity.png"]) if "validity.png" in decoded else (None, [])
    drawings = [
        drawing(images[name], decoded[name]) if name in decoded else None
        for name in ("disparity_view.png", "elevation.png")
    ]
    return Gallery(tuple(wipes), tuple(curves[0]), tuple(curves[1]), valid, tuple(reasons), *drawings)
