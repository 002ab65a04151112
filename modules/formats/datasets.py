"""Data sets of stereo pairs with ground truth, in the layouts that are in use.

`index`: a folder with an `INDEX.json`, a list of entries. Each has `dataset`, `scene`, `left`, `right` (paths inside
the folder), `split` and `ndisp`; with ground truth also `gt` (PFM, or an image with disparity = value / `gt_scale` and
`invalid_value` where unknown) and `gt_mask` (255 = not occluded); optionally `group` (pairs of one scene) and
`radiometric_difference`.

`middlebury`: Middlebury v3 and ETH3D two-view, a folder per scene with `im0.png`, `im1.png`, `calib.txt` (`ndisp`) and,
there or in the same folder of `<folder>_gt`, `disp0GT.pfm` or `disp0.pfm` and `mask0nocc.png`.

`kitti`: KITTI 2015 (`image_2`, `image_3`, `disp_noc_0`) and 2012 (`colored_0`, `colored_1`, `disp_noc`), directly or in
`training`; the first frame of each sequence, `*_10.png`, has the truth.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from modules.formats.disparity import read_disparity_png, read_pfm
from modules.formats.errors import FormatError
from modules.formats.images import read_image
from modules.types import FloatImage, Mask, Views

NOT_OCCLUDED = 255
KITTI_NDISP = 192  # what the benchmark's own baselines search
NDISP_STEP = 16  # a range that follows from the truth is rounded up to this


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


@dataclass(frozen=True)
class DatasetEntry:
    """Where the files of one pair are; nothing of it is read before `load`.

    Attributes
    ----------
    name, group, split : str
    left, right : Path
    truth, mask : Path or None
    read_truth : callable
        From the path of the truth to float32 (H, W), px, NaN where unknown.
    ndisp : int or None
        None where only the truth tells.
    differs : bool
    """

    name: str
    group: str
    split: str
    left: Path
    right: Path
    truth: Path | None = None
    mask: Path | None = None
    read_truth: Callable[[Path], FloatImage] = read_pfm
    ndisp: int | None = None
    differs: bool = False

    def load(self) -> DatasetPair:
        """Read the pair.

        Raises
        ------
        FormatError
            A file is missing or not what it should be.
        """
        views = Views(read_image(self.left), read_image(self.right))
        truth = scored = None
        ndisp = self.ndisp
        if self.truth is not None:
            truth = self.read_truth(self.truth)
            if truth.shape != views.shape:
                raise FormatError(
                    f"{self.truth} is {truth.shape[1]}x{truth.shape[0]} and {self.left} is "
                    f"{views.shape[1]}x{views.shape[0]}; give the truth of this image"
                )
            scored = np.isfinite(truth)
            if self.mask is not None:
                mask = read_image(self.mask)
                scored &= (mask if mask.ndim == 2 else mask[..., 0]) == NOT_OCCLUDED
            if ndisp is None and scored.any():
                ndisp = math.ceil((float(np.nanmax(truth)) + 1.0) / NDISP_STEP) * NDISP_STEP
        if ndisp is None:
            raise FormatError(f"{self.left}: neither the data set nor a truth says how many disparities to search")
        return DatasetPair(self.name, self.group, self.split, views, truth, scored, ndisp, self.differs)


def list_pairs(folder: Path | str, layout: str | None = None, split: str | None = None) -> tuple[DatasetEntry, ...]:
    """List the pairs of a data set without reading an image.

    Parameters
    ----------
    folder : path
    layout : {"index", "middlebury", "kitti"}, optional
        Found out from the folder if not given.
    split : str, optional
        Only the pairs of this split.

    Raises
    ------
    FormatError
        The folder has no such layout or holds no pair, or its index lacks something.
    """
    folder = Path(folder)
    layout = layout or _layout_of(folder)
    if layout not in LAYOUTS:
        raise FormatError(f"there is no layout {layout!r}; known: {', '.join(LAYOUTS)}")
    found = tuple(_named(entry for entry in LAYOUTS[layout](folder) if split is None or entry.split == split))
    if not found:
        wanted = "" if split is None else f" of split {split!r}"
        raise FormatError(f"{folder} holds no pair{wanted} in the layout {layout!r}; give the folder that holds them")
    return found


def _named(entries: Iterable[DatasetEntry]) -> Iterator[DatasetEntry]:
    """Tell pairs of one name apart, as the variants of a scene, by the folder of their left image, then by a number."""
    taken: set[str] = set()
    for entry in entries:
        name = entry.name if entry.name not in taken else f"{entry.name}, {entry.left.parent.name}"
        number = 2
        while name in taken:
            name, number = f"{entry.name}, {number}", number + 1
        taken.add(name)
        yield replace(entry, name=name)


def read_index(folder: Path | str, split: str | None = None) -> Iterator[DatasetPair]:
    """Read the pairs of a folder with an `INDEX.json` one by one; see `list_pairs`."""
    for entry in list_pairs(folder, "index", split):
        yield entry.load()


def _layout_of(folder: Path) -> str:
    if (folder / "INDEX.json").is_file():
        return "index"
    if any((root / "image_2").is_dir() or (root / "colored_0").is_dir() for root in (folder, folder / "training")):
        return "kitti"
    if any(True for _ in folder.glob("*/im0.png")):
        return "middlebury"
    raise FormatError(
        f"{folder} is no data set: it has no INDEX.json, no folders with im0.png (Middlebury, ETH3D) and no image_2 or "
        "colored_0 (KITTI)"
    )


def _index(folder: Path) -> Iterator[DatasetEntry]:
    index = folder / "INDEX.json"
    try:
        entries = json.loads(index.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FormatError(f"{index} cannot be read as JSON ({error}); give a folder with an INDEX.json") from error
    for number, entry in enumerate(entries):
        try:
            yield _index_entry(folder, entry)
        except KeyError as error:
            raise FormatError(f"{index}: entry {number} has no {error}; add it") from error


def _index_entry(folder: Path, entry: Mapping[str, Any]) -> DatasetEntry:
    truth = folder / entry["gt"] if entry.get("gt") else None
    read_truth: Callable[[Path], FloatImage] = read_pfm
    if truth is not None and truth.suffix != ".pfm":
        read_truth = partial(_scaled, scale=float(entry["gt_scale"]), invalid=entry.get("invalid_value", 0))
    return DatasetEntry(
        name=f"{entry['dataset']}/{entry['scene']}",
        group=str(entry.get("group", entry["scene"])),
        split=str(entry.get("split", "")),
        left=folder / entry["left"],
        right=folder / entry["right"],
        truth=truth,
        mask=folder / entry["gt_mask"] if entry.get("gt_mask") else None,
        read_truth=read_truth,
        ndisp=int(entry["ndisp"]),
        differs=bool(entry.get("radiometric_difference", False)),
    )


def _scaled(path: Path, scale: float, invalid: float) -> FloatImage:
    stored = read_image(path)
    stored = stored if stored.ndim == 2 else stored[..., 0]
    return np.where(stored == invalid, np.nan, stored / scale).astype(np.float32)


def _middlebury(folder: Path) -> Iterator[DatasetEntry]:
    for left in sorted(folder.glob("*/im0.png")):
        scene = left.parent
        homes = (scene, folder.with_name(folder.name + "_gt") / scene.name)
        known = re.search(r"^\s*ndisp\s*=\s*(\d+)", _text_of(scene / "calib.txt"), re.MULTILINE)
        yield DatasetEntry(
            name=f"{folder.name}/{scene.name}",
            group=scene.name,
            split="",
            left=left,
            right=scene / "im1.png",
            truth=_first(home / name for home in homes for name in ("disp0GT.pfm", "disp0.pfm")),
            mask=_first(home / "mask0nocc.png" for home in homes),
            ndisp=int(known[1]) if known and int(known[1]) > 0 else None,
        )


def _kitti(folder: Path) -> Iterator[DatasetEntry]:
    root = folder / "training" if (folder / "training").is_dir() else folder
    for left_name, right_name, truth_name in (
        ("image_2", "image_3", "disp_noc_0"),
        ("colored_0", "colored_1", "disp_noc"),
    ):
        for left in sorted((root / left_name).glob("*_10.png")):
            truth = root / truth_name / left.name
            yield DatasetEntry(
                name=f"{folder.name}/{left.stem}",
                group=left.stem,
                split="",
                left=left,
                right=root / right_name / left.name,
                truth=truth if truth.is_file() else None,
                read_truth=read_disparity_png,
                ndisp=KITTI_NDISP,
            )


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _first(paths: Iterator[Path]) -> Path | None:
    return next((path for path in paths if path.is_file()), None)


LAYOUTS: Mapping[str, Callable[[Path], Iterator[DatasetEntry]]] = MappingProxyType(
    {"index": _index, "middlebury": _middlebury, "kitti": _kitti}
)
