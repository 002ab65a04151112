"""Pairs of images in a folder, found by their names."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from modules.formats.errors import FormatError

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm")
SIDE = re.compile(r"(?<![a-z])(left|right)(?![a-z])", re.IGNORECASE)


@dataclass(frozen=True)
class PairFiles:
    """The two images of a pair; `name` is what their names have beside left and right."""

    name: str
    left: Path
    right: Path


def find_pairs(folder: Path | str) -> tuple[list[PairFiles], list[Path]]:
    """Find the pairs in a folder.

    Known are `left01.jpg` and `right01.jpg`, `a_left.png` and `a_right.png`, and `left/1.png` and `right/1.png`.

    Returns
    -------
    pairs : list of PairFiles
        Sorted by name.
    lonely : list of Path
        Images of one side without the other.

    Raises
    ------
    FormatError
        The folder does not exist or holds no pair.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FormatError(f"{folder} is no folder; give the folder that holds left01.png, right01.png and so on")
    sides: dict[str, dict[str, Path]] = {}
    inside = [*folder.iterdir(), *(path for side in ("left", "right") for path in (folder / side).glob("*"))]
    for path in sorted(inside):
        found = SIDE.search(str(path.relative_to(folder)))
        if path.suffix.lower() in SUFFIXES and path.is_file() and found:
            rest = SIDE.sub("", str(path.relative_to(folder).with_suffix("")), count=1)
            sides.setdefault(rest.strip("/\\_-. ") or "pair", {})[found.group(1).lower()] = path
    pairs = [PairFiles(name, both["left"], both["right"]) for name, both in sorted(sides.items()) if len(both) == 2]
    lonely = sorted(path for both in sides.values() if len(both) == 1 for path in both.values())
    if not pairs:
        raise FormatError(
            f"{folder} holds no pair of images ({len(lonely)} of one side only); "
            "name them left01.png and right01.png, or put them into folders left and right"
        )
    return pairs, lonely
