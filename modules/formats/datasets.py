"""Data sets of stereo pairs with ground truth: a folder with an `INDEX.json`.

The index is a list of entries. Each has `dataset`, `scene`, `left`, `right` (paths inside the folder), `split` and
`ndisp`; with ground truth also `gt` (PFM, or an image with disparity = value / `gt_scale` and `invalid_value` where
unknown) and `gt_mask` (255 = not occluded); optionally `group` (pairs of one scene) and `radiometric_difference`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modules.formats.disparity import read_pfm
from modules.formats.errors import FormatError
from modules.formats.images import read_image
from modules.types import FloatImage, Mask, Views

NOT_OCCLUDED = 255


@dataclass(frozen=True)
class DatasetPair:
    """One pair of a data set.

    Attributes
    ----------
    name, group, split : str
    views : Views
    truth_px : float32 (H, W) or None
        True disparity, NaN where unknown.
    scored : bool (H, W) or None
        Pixels that count: known and not occluded.
    ndisp : int
        Disparities to search, from 0.
    differs : bool
        Whether the pair differs radiometrically by itself.
    """

    name: str
    group: str
    split: str
    views: Views
    truth_px: FloatImage | None
    scored: Mask | None
    ndisp: int
    differs: bool


def read_index(folder: Path | str, split: str | None = None) -> Iterator[DatasetPair]:
    """Read the pairs of a data set one by one.

    Parameters
    ----------
    folder : path
    split : str, optional
        Only the pairs of this split.

    Raises
    ------
    FormatError
        The index is missing or not JSON, or an entry lacks something.
    """
    folder = Path(folder)
    index = folder / "INDEX.json"
    try:
        entries = json.loads(index.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FormatError(f"{index} cannot be read as JSON ({error}); give a folder with an INDEX.json") from error
    for number, entry in enumerate(entries):
        if split is not None and entry.get("split") != split:
            continue
        try:
            yield _read_pair(folder, entry)
        except KeyError as error:
            raise FormatError(f"{index}: entry {number} has no {error}; add it") from error


def _read_pair(folder: Path, entry: dict[str, Any]) -> DatasetPair:
    views = Views(read_image(folder / entry["left"]), read_image(folder / entry["right"]))
    truth = scored = None
    if entry.get("gt"):
        truth = _read_truth(folder / entry["gt"], entry)
        scored = np.isfinite(truth)
        if entry.get("gt_mask"):
            mask = read_image(folder / entry["gt_mask"])
            scored &= (mask if mask.ndim == 2 else mask[..., 0]) == NOT_OCCLUDED
    return DatasetPair(
        name=f"{entry['dataset']}/{entry['scene']}",
        group=str(entry.get("group", entry["scene"])),
        split=str(entry.get("split", "")),
        views=views,
        truth_px=truth,
        scored=scored,
        ndisp=int(entry["ndisp"]),
        differs=bool(entry.get("radiometric_difference", False)),
    )


def _read_truth(path: Path, entry: dict[str, Any]) -> FloatImage:
    if path.suffix == ".pfm":
        return read_pfm(path)
    stored = read_image(path)
    stored = stored if stored.ndim == 2 else stored[..., 0]
    unknown = stored == entry.get("invalid_value", 0)
    return np.where(unknown, np.nan, stored / float(entry["gt_scale"])).astype(np.float32)
