"""One pair of a batch."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

LONGEST_NAME = 120  # bytes; file systems allow 255, and temporary folders need a few more


@dataclass(frozen=True)
class BatchItem:
    """One pair of a batch: where its files are, and what is stated about it.

    Attributes
    ----------
    name : str
        Unique within the batch.
    left, right : Path
    calibration, attitude : Path or None
    angles_deg : (roll, pitch, yaw) or None
    disparity_range_px : (int, int) or None
    """

    name: str
    left: Path
    right: Path
    calibration: Path | None = None
    attitude: Path | None = None
    angles_deg: tuple[float, float, float] | None = None
    disparity_range_px: tuple[int, int] | None = None

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
