"""The disparity, why pixels have none, and how likely it is right, as pictures with a legend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from expert.report.pictures import Picture, decode, drawing, picture, thumbnail
from modules.formats.disparity import parse_pfm, view_range_px
from modules.formats.errors import FormatError
from modules.types import FloatImage, Image, Invalid

REASONS = {
    Invalid.NO_MATCH: ("the matcher gave no disparity", "#e15759"),
    Invalid.MASKED: ("excluded by a mask of the pair", "#7f7f7f"),
    Invalid.OUTSIDE: ("its match would lie outside the right image", "#4e79a7"),
    Invalid.RANGE_BORDER: ("best disparity at an end of the searched range", "#b07aa1"),
    Invalid.LEFT_RIGHT: ("the match of the match is another pixel", "#f28e2b"),
    Invalid.NOT_UNIQUE: ("a second disparity is nearly as good", "#edc948"),
    Invalid.FLAT_MINIMUM: ("the cost hardly depends on the disparity", "#9c755f"),
    Invalid.SPECKLE: ("part of a small island", "#76b7b2"),
    Invalid.SATURATED: ("clipped in either image", "#ff9da7"),
    Invalid.TEXTURELESS: ("too little texture to decide", "#59a14f"),
    Invalid.LOW_CONFIDENCE: ("below the confidence limit", "#5c3317"),
    Invalid.SKY: ("sky, no terrain", "#86bcff"),
    Invalid.FILLED: ("interpolated", "#d4a6c8"),
}
VALID_COLOUR = "#dfe3e8"


@dataclass(frozen=True)
class Share:
    """How many pixels have a flag, and its colour in the picture."""

    flag: str
    meaning: str
    colour: str
    count: int
    percent: float


@dataclass(frozen=True)
class DisparityScale:
    """The colours of the disparity with what their ends stand for, in px and, where a calibration is known, in m."""

    bar: str
    low: str
    high: str


@dataclass(frozen=True)
class DisparityPictures:
    """What the run did not write is None or empty."""

    disparity: Picture | None = None
    scale: DisparityScale | None = None
    small: Picture | None = None
    validity: Picture | None = None
    confidence: Picture | None = None
    valid: Share | None = None
    reasons: tuple[Share, ...] = ()


def validity_shares(validity: Image) -> tuple[Share, list[Share]]:
    """Return the share of valid pixels, and of every flag that occurs, most frequent first.

    A pixel may have several flags.
    """
    total = validity.size
    values, counts = np.unique(validity.astype(np.uint16), return_counts=True)
    shares = []
    for flag, (meaning, colour) in REASONS.items():
        count = int(counts[(values & int(flag)) != 0].sum())
        if count:
            shares.append(Share(flag.name or "", meaning, colour, count, 100.0 * count / total))
    valid = int(counts[values == 0].sum())
    share = Share("VALID", "has a disparity", VALID_COLOUR, valid, 100.0 * valid / total)
    return share, sorted(shares, key=lambda item: -item.count)


def validity_picture(validity: Image) -> Picture:
    """Colour every pixel by its first reason in the order of `Invalid`."""
    highest = int(validity.max(initial=0))
    colours = np.zeros((highest + 1, 3), np.uint8)
    for value in np.unique(validity):
        flag = next((flag for flag in REASONS if int(value) & int(flag)), None)
        text = VALID_COLOUR if flag is None else REASONS[flag][1]
        colours[value] = tuple(bytes.fromhex(text[1:]))
    return picture(colours[validity], photo=False)


def _scale(disparity_px: FloatImage, rig: Mapping[str, object]) -> DisparityScale:
    low, high = view_range_px(disparity_px)
    ramp = cv2.applyColorMap(np.arange(0, 256, 15, dtype=np.uint8), cv2.COLORMAP_TURBO)[:, 0, ::-1]
    bar = ", ".join(f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in ramp)
    return DisparityScale(bar, _end(low, rig), _end(high, rig))


def _end(disparity_px: float, rig: Mapping[str, object]) -> str:
    """Write a disparity, and the depth `focal * baseline / (d + doffs)` where the rig is known."""
    focal, baseline, doffs = (rig.get(name) for name in ("focal_px", "baseline_m", "doffs_px"))
    if not isinstance(focal, int | float) or not isinstance(baseline, int | float):
        return f"{disparity_px:.1f} px"
    shifted = disparity_px + (doffs if isinstance(doffs, int | float) else 0.0)
    return f"{disparity_px:.1f} px, " + (f"{focal * baseline / shifted:.3g} m" if shifted > 0 else "infinitely far")


def disparity_pictures(files: Mapping[str, bytes], rig: Mapping[str, object]) -> DisparityPictures:
    """Make the pictures of the disparity.

    Parameters
    ----------
    files : mapping of str to bytes
    rig : mapping
        Fields of the fact `rig`; without focal length and baseline no depth is told.

    Raises
    ------
    ValueError
        A file is damaged.
    """
    disparity, confidence = (
        drawing(name, files[name]) if name in files else None for name in ("disparity_view.png", "confidence.png")
    )
    small = thumbnail("disparity_view.png", files["disparity_view.png"]) if disparity else None
    scale = None
    if "disparity.pfm" in files:
        try:
            scale = _scale(parse_pfm("disparity.pfm", files["disparity.pfm"]), rig)
        except FormatError as error:
            raise ValueError(str(error)) from error
    if "validity.png" not in files:
        return DisparityPictures(disparity, scale, small, None, confidence)
    validity = decode("validity.png", files["validity.png"])
    valid, reasons = validity_shares(validity)
    return DisparityPictures(disparity, scale, small, validity_picture(validity), confidence, valid, tuple(reasons))
