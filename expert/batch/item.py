"""One pair of a batch: its files, and what is stated about it."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

from modules.formats.imu import MAX_GAP_S
from modules.primitives.frames import Convention

LONGEST_NAME = 120  # bytes; file systems allow 255, and temporary folders need a few more


@dataclass(frozen=True)
class Stated:
    """What is stated about one pair, or about all pairs that say nothing else.

    Attributes
    ----------
    calibration : tuple of Path
        One file, or the two of OpenCV or ROS.
    attitude : Path or None
    angles_deg : (roll, pitch, yaw) or None
        Yaw may be None.
    imu : Path or None
        Log of the inertial unit, asked for the attitude at `time_s`.
    time_s : float or None
        When the pair was taken, on the clock of the log, s.
    disparity_range_px : (int, int) or None
    rectified, scale_calibration : bool
    alpha : float or None
        How the calibration is used; see `StereoPair.load`.
    convention : {"rep103", "aerospace", "euroc"}
        Of angles and log.
    max_gap_s : float
        Longest gap of the log that is interpolated, s.
    mask : Path or None
        Image that is black where the robot itself is seen; see `StereoPair.without_masked`.
    datum_deg : (latitude, longitude) or None
        Where the origin lies; see `Result.save`.
    """

    calibration: tuple[Path, ...] = ()
    attitude: Path | None = None
    angles_deg: tuple[float, float, float | None] | None = None
    imu: Path | None = None
    time_s: float | None = None
    disparity_range_px: tuple[int, int] | None = None
    rectified: bool = False
    scale_calibration: bool = False
    alpha: float | None = None
    convention: Convention = "rep103"
    mask: Path | None = None
    datum_deg: tuple[float, float] | None = None
    max_gap_s: float = MAX_GAP_S

    def over(self, common: Stated) -> Stated:
        """Return it with what is common where it says nothing; of the ways to state an attitude it keeps its own."""
        levelled = self.attitude is not None or self.angles_deg is not None or self.imu is not None
        return replace(
            common,
            calibration=self.calibration or common.calibration,
            attitude=self.attitude if levelled else common.attitude,
            angles_deg=self.angles_deg if levelled else common.angles_deg,
            imu=self.imu if levelled else common.imu,
            time_s=self.time_s,
            disparity_range_px=self.disparity_range_px or common.disparity_range_px,
            mask=self.mask or common.mask,
            datum_deg=self.datum_deg or common.datum_deg,
        )


def natural(name: str) -> tuple[str | int, ...]:
    """Return what names are sorted by so that 2 comes before 10.

    Examples
    --------
    >>> sorted(["day 1/10", "day 1/9"], key=natural)
    ['day 1/9', 'day 1/10']
    """
    return tuple(int(part) if part.isdecimal() else part for part in re.split(r"([0-9]+)", name))


@dataclass(frozen=True)
class BatchItem:
    """One pair of a batch.

    Attributes
    ----------
    name : str
        Unique within the batch.
    left, right : Path
    stated : Stated
    """

    name: str
    left: Path
    right: Path
    stated: Stated = Stated()

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that the pair is read from."""
        stated = self.stated
        others = (stated.attitude, stated.imu, stated.mask)
        return (self.left, self.right, *stated.calibration, *(path for path in others if path is not None))

    @property
    def facts(self) -> tuple[object, ...]:
        """What is stated beside the files, and which part each file plays."""
        own = self.stated
        parts = (len(own.calibration), own.attitude is not None, own.imu is not None, own.mask is not None)
        reading = (own.rectified, own.scale_calibration, own.alpha, own.convention, own.max_gap_s)
        return (own.angles_deg, own.time_s, own.disparity_range_px, own.datum_deg, *parts, *reading)

    def moved(self, files: Sequence[Path]) -> BatchItem:
        """Return it with its `files` at other places, given in the same order."""
        own, places = self.stated, iter(files)
        left, right = next(places), next(places)
        stated = replace(
            own,
            calibration=tuple(next(places) for _ in own.calibration),
            attitude=None if own.attitude is None else next(places),
            imu=None if own.imu is None else next(places),
            mask=None if own.mask is None else next(places),
        )
        return BatchItem(self.name, left, right, stated)

    @property
    def folder(self) -> str:
        """A file name that no other item has: the name, what file systems do not bear written in percent."""
        text = quote(self.name.encode("utf-8", "surrogateescape"), safe=" ()+,=@")
        if text.startswith("."):
            text = "%2E" + text[1:]
        if len(text) > LONGEST_NAME:
            digest = hashlib.sha256(self.name.encode("utf-8", "surrogateescape")).hexdigest()[:12]
            text = f"{text[: LONGEST_NAME - 13]}~{digest}"
        return text
