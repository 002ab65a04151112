"""Where the pairs of a batch come from: a folder of some layout, two name patterns, or a manifest."""

from __future__ import annotations

import fnmatch
import logging
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

from expert.batch.item import BatchItem, Stated, natural
from expert.batch.manifest import read_manifest
from expert.batch.runlog import NAME as RUN_LOG
from modules.formats.atomic import MARK
from modules.formats.errors import FormatError

_log = logging.getLogger(__name__)

IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm")
# Names of the two cameras, in files (`left_01.png`, `01-right.png`) and in folders (`left/01.png`).
SIDES = (("left", "right"), ("cam0", "cam1"), ("im0", "im1"), ("image_0", "image_1"), ("image_2", "image_3"))
CALIBRATIONS = (
    "calib.txt",
    "calib.yaml",
    "calib.yml",
    "calibration.yaml",
    "calibration.yml",
    "calib_cam_to_cam/{number}.txt",  # KITTI 2015: one for each frame
    "calib_cam_to_cam.txt",  # KITTI raw data: one for each day
)
BOTH = (  # names of two files of one calibration, beside the left and beside the right images or above them
    ("sensor.yaml", "sensor.yaml"),  # EuRoC
    ("left.yaml", "right.yaml"),  # ROS
    ("intrinsics.yml", "extrinsics.yml"),  # OpenCV
)
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def find_pairs(source: Path, pattern: tuple[str, str] | None = None) -> tuple[BatchItem, ...]:
    """List the pairs of a source, in the order of their names; nothing but names is read.

    Parameters
    ----------
    source : Path
        A manifest (`.csv`, `.jsonl`), or a folder: pairs are files whose paths differ only in the name of the camera
        (left and right, cam0 and cam1, im0 and im1, image_2 and image_3, image_0 and image_1), in the file or in a
        folder above it. That covers KITTI, EuRoC and Middlebury. A `calib.txt`, `calib.yaml`, `calibration.yaml` or
        `calib_cam_to_cam.txt` beside the images, or in a folder above them within the source, is theirs; so are two
        files: `left.yaml` and `right.yaml`, `intrinsics.yml` and `extrinsics.yml`, or the `sensor.yaml` of each camera.
    pattern : (str, str), optional
        Two patterns of paths below the folder with one `*` each, for other names.

    Raises
    ------
    FormatError
        The source is missing, holds no pair, or the manifest has errors; all of them are listed.
    """
    if source.is_file():
        return tuple(read_manifest(source))
    if not source.is_dir():
        raise FormatError(f"{source} is neither a folder nor a manifest (.csv, .jsonl); check the path")
    files = sorted(_files(source))
    found = _by_pattern(source, files, pattern) if pattern else _by_side(files)
    if found and not pattern:
        _warn_of_lone(files, found)
    if not found:
        wanted = "files that match the pattern" if pattern else "files named left and right, cam0 and cam1, im0 and im1"
        raise FormatError(
            f"{source} holds {len(files)} images but no pair of {wanted}; give --pattern LEFT RIGHT or a manifest"
        )
    return tuple(_item(source, name, *paths) for name, paths in sorted(found.items(), key=lambda one: natural(one[0])))


def _files(source: Path) -> Iterator[str]:
    """Yield the images below a folder, relative to it.

    A folder that was seen before, by any name, is not entered, nor is one that holds results: of a pair, or of a batch.
    """
    seen: set[str] = set()
    for folder, folders, names in os.walk(source, followlinks=True):
        real = os.path.realpath(folder)
        if real in seen or RUN_LOG in names or {MARK, "decision.json"} <= set(names):
            folders.clear()
            continue
        seen.add(real)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in names:
            if name.lower().endswith(IMAGES) and not name.startswith("."):
                yield os.path.relpath(os.path.join(folder, name), source)


def _by_side(files: list[str]) -> dict[str, tuple[str, str]]:
    """Pair the files whose paths differ in the name of the camera only."""
    known = set(files)
    found: dict[str, tuple[str, str]] = {}
    for path in files:
        for left, right in SIDES:
            for start, end in _places(path, left):
                other = path[:start] + _like(path[start:end], right) + path[end:]
                if other in known and other != path:
                    stem = os.path.splitext(path)[0]
                    name = re.sub(r"[_\-. ]*/[/_\-. ]*", "/", stem[:start] + stem[end:]).strip("/_-. \n")
                    if found.get(name, (path, other)) != (path, other):
                        name = stem  # two cameras in one folder, say: no pair is dropped for its name
                    found.setdefault(name or stem, (path, other))
    return found


def _warn_of_lone(files: list[str], found: Mapping[str, tuple[str, str]]) -> None:
    """Name the images of one camera whose other one is missing."""
    paired = {path for paths in found.values() for path in paths}
    words = [word for side in SIDES for word in side]
    lone = [path for path in files if path not in paired and any(any(_places(path, word)) for word in words)]
    if lone:
        shown = ", ".join(map(repr, lone[:3])) + (", ..." if len(lone) > 3 else "")
        _log.warning("%d images have no partner of the other camera and are left out: %s", len(lone), shown)


def _places(path: str, side: str) -> Iterator[tuple[int, int]]:
    """Find the name of a camera where no letter or digit goes on with it, digits behind `left` and `right` excepted."""
    more = "" if side[-1].isdigit() else "a-z"
    ending = rf"(?![{more or '0-9'}])"
    for match in re.finditer(rf"(?<![a-z0-9]){re.escape(side)}{ending}", path, re.IGNORECASE):
        yield match.span()


def _like(text: str, word: str) -> str:
    """Write a word in the case of a text."""
    return word.upper() if text.isupper() else word.capitalize() if text[0].isupper() else word


def _by_pattern(source: Path, files: list[str], pattern: tuple[str, str]) -> dict[str, tuple[str, str]]:
    for text in pattern:
        if text.count("*") != 1:
            raise FormatError(f"--pattern {text!r} has {text.count('*')} stars; give one, e.g. 'left/*.png'")
    matches: list[Mapping[str, str]] = []
    for text in pattern:
        before, after = (re.escape(part) for part in text.split("*"))
        matches.append({m[1]: path for path in files if (m := re.fullmatch(f"{before}(.*){after}", path))})
    return {name: (matches[0][name], matches[1][name]) for name in matches[0] if name in matches[1]}


def _item(source: Path, name: str, left: str, right: str) -> BatchItem:
    shown = name.encode("utf-8", "backslashreplace").decode()  # names of files need not be UTF-8
    return BatchItem(shown, source / left, source / right, Stated(_calibration(source, Path(left), Path(right))))


def _calibration(source: Path, left: Path, right: Path) -> tuple[Path, ...]:
    """Return the calibration nearest to a pair: beside its images, or above them within the source; none is ()."""
    number = left.stem.split("_")[0]
    for of_left, of_right in zip_longest(left.parents, right.parents, fillvalue=Path()):
        here, there = source / of_left, source / of_right
        for name in CALIBRATIONS:
            path = here / name.format(number=number)
            if path.is_file():
                return (path,)
        for names in BOTH:
            first, second = here / names[0], there / names[1]
            if first != second and first.is_file() and second.is_file():
                return (first, second)
    return ()


def timed(items: Sequence[BatchItem], unit: str | None = None) -> tuple[BatchItem, ...]:
    """Return the items with the time that each was taken, for a log of the inertial unit.

    Parameters
    ----------
    items : sequence of BatchItem
    unit : {"s", "ms", "us", "ns"}, optional
        Of the number at the end of the names, where the items state no time; without a unit it is no time.

    Raises
    ------
    FormatError
        Items without a time; all of them are counted, and the first ones named.
    """
    found = [_timed(item, unit) for item in items]
    lacking = [item.name for item in found if item.stated.time_s is None and not _oriented(item)]
    if lacking:
        shown = ", ".join(map(repr, lacking[:3])) + (", ..." if len(lacking) > 3 else "")
        raise FormatError(
            f"{len(lacking)} of {len(items)} pairs state no time for the log of the inertial unit ({shown}); "
            "give a manifest with time_s, or --time-in-name and its unit"
        )
    return tuple(found)


def _oriented(item: BatchItem) -> bool:
    """Whether the item states an attitude, which goes before the log."""
    return item.stated.attitude is not None or item.stated.angles_deg is not None


def _timed(item: BatchItem, unit: str | None) -> BatchItem:
    number = re.search(r"\d+(\.\d+)?(?=\D*$)", item.name.rpartition("/")[2])
    if item.stated.time_s is not None or unit is None or number is None:
        return item
    return replace(item, stated=replace(item.stated, time_s=float(number[0]) * TIME_UNITS[unit]))


def select(items: tuple[BatchItem, ...], pattern: str | None, limit: int | None) -> tuple[BatchItem, ...]:
    """Keep the items whose names match a shell pattern, and the first few of them."""
    kept = [item for item in items if pattern is None or fnmatch.fnmatchcase(item.name, pattern)]
    return tuple(kept if limit is None else kept[:limit])
