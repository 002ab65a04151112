"""Manifests: the pairs of a batch as CSV with a header, or as JSON lines."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path

from expert.batch.item import BatchItem, Stated
from modules.formats.errors import FormatError
from modules.types import Datum

REQUIRED = ("left", "right")
ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
RANGE = ("min_disparity_px", "max_disparity_px")
PLACE = ("latitude_deg", "longitude_deg")
FILES = (*REQUIRED, "calibration", "calibration_2", "attitude", "imu", "mask")
COLUMNS = ("name", *FILES, "time_s", *ANGLES, *RANGE, *PLACE)
Line = tuple[int, Mapping[str, object]]


class ManifestError(FormatError):
    """A manifest with errors; the message lists them by line."""


def read_manifest(path: Path) -> list[BatchItem]:
    """Read a manifest.

    Parameters
    ----------
    path : Path
        `.csv` with a header, or `.jsonl`. Columns: `left`, `right` (paths, relative to the manifest), and optionally
        `name`, `calibration`, `calibration_2` (the other file of two that belong together), `attitude`, `imu` (paths),
        `mask` (path), `time_s`, `roll_deg`, `pitch_deg`, `yaw_deg`, `min_disparity_px`, `max_disparity_px`,
        `latitude_deg`, `longitude_deg`. Empty values are absent.

    Raises
    ------
    ManifestError
        All problems, each with its line.
    """
    try:
        text = path.read_text(encoding="utf-8-sig", errors="surrogateescape")
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check the path") from error
    problems: list[str] = []
    lines = _json_lines(text, problems) if path.suffix.lower() in (".jsonl", ".ndjson") else _csv_lines(text, problems)
    items: list[BatchItem] = []
    taken: dict[str, int] = {}
    for number, values in lines:
        found: list[str] = []
        item = _item(path.parent, values, found)
        if item is not None:
            if item.name in taken:
                found.append(f"the name {item.name!r} stands in line {taken[item.name]} already; give another name")
            taken.setdefault(item.name, number)
            items.append(item)
        problems += [f"line {number}: {problem}" for problem in found]
    if not items and not problems:
        problems.append("line 1: there is no pair; give a header with left and right, and a line per pair")
    if problems:
        raise ManifestError("\n".join(f"{path}: {problem}" for problem in problems))
    return items


def _csv_lines(text: str, problems: list[str]) -> Iterator[Line]:
    reader = csv.reader(text.splitlines(keepends=True))
    try:
        header = [name.strip() for name in next(reader, [])]
    except csv.Error as error:
        problems.append(f"line 1: {error}")
        return
    missing = [name for name in REQUIRED if name not in header]
    unknown = [name for name in header if name not in COLUMNS]
    if missing or unknown:
        said = [f"column {name!r} is missing" for name in missing] + [f"column {name!r} is unknown" for name in unknown]
        problems.append(f"line 1: {'; '.join(said)}; known: {', '.join(COLUMNS)}")
        return
    line = reader.line_num + 1
    try:
        for row in reader:
            if row and len(row) != len(header):
                problems.append(f"line {line}: {len(row)} values and {len(header)} columns; quote values with commas")
            elif row:
                yield line, {name: value for name, value in zip(header, row, strict=True) if value != ""}
            line = reader.line_num + 1
    except csv.Error as error:
        problems.append(f"line {line}: {error}")


def _json_lines(text: str, problems: list[str]) -> Iterator[Line]:
    for number, line in enumerate(text.split("\n"), 1):
        if not line.strip():
            continue
        try:
            values = json.loads(line)
        except ValueError as error:
            problems.append(f"line {number}: not JSON ({error})")
            continue
        if not isinstance(values, dict):
            problems.append(f"line {number}: {type(values).__name__} where an object with left and right is expected")
            continue
        unknown = [name for name in values if name not in COLUMNS]
        if unknown:
            problems.append(f"line {number}: {', '.join(map(repr, unknown))} unknown; known: {', '.join(COLUMNS)}")
        yield number, {name: value for name, value in values.items() if value not in (None, "") and name in COLUMNS}


def _item(home: Path, values: Mapping[str, object], problems: list[str]) -> BatchItem | None:
    paths = _paths(home, values, problems)
    stated = _stated(paths, values, problems)
    if not all(name in paths for name in REQUIRED):
        return None
    name = str(values.get("name", Path(str(values["left"])).with_suffix("")))
    return BatchItem(name, paths["left"], paths["right"], stated)


def _paths(home: Path, values: Mapping[str, object], problems: list[str]) -> dict[str, Path]:
    """Return the files of a line; those that are not there are problems."""
    paths: dict[str, Path] = {}
    for name in FILES:
        if name in values:
            paths[name] = home / str(values[name])
            if not paths[name].is_file():
                problems.append(f"{name} {str(values[name])!r} is no file; paths are relative to the manifest")
        elif name in REQUIRED:
            problems.append(f"{name} is missing; give the path of the {name} image")
    if "calibration_2" in paths and "calibration" not in paths:
        problems.append("calibration_2 is given without calibration; give both, or the one file as calibration")
    return paths


def _stated(paths: Mapping[str, Path], values: Mapping[str, object], problems: list[str]) -> Stated:
    """Return what a line says of its pair beside the images."""
    angles = [_number(values, name, problems) for name in ANGLES]
    turned = any(angle is not None for angle in angles)
    ends = [_number(values, name, problems) for name in RANGE]
    time_s = _number(values, "time_s", problems)
    if (ends[0] is None) != (ends[1] is None):
        problems.append("only one end of the disparity range is given; give min_disparity_px and max_disparity_px")
    known = [int(end) for end in ends if end is not None]
    if len(known) == 2 and known[1] <= known[0]:
        problems.append(f"disparity range {known[0]} {known[1]} is empty; the second number must be larger")
    ways = [name for name in ("attitude", "imu") if name in paths] + ["angles"] * turned
    if len(ways) > 1:
        problems.append(f"{' and '.join(ways)} are given; an attitude is stated in one way, leave out the others")
    if "imu" in paths and "time_s" not in values:
        problems.append("imu is given without time_s; give the time of the pair on the clock of the log")
    return Stated(
        tuple(paths[name] for name in ("calibration", "calibration_2") if name in paths),
        paths.get("attitude"),
        (angles[0] or 0.0, angles[1] or 0.0, angles[2]) if turned else None,
        paths.get("imu"),
        time_s,
        (known[0], known[1]) if len(known) == 2 else None,
        mask=paths.get("mask"),
        datum_deg=_place(values, problems),
    )


def _place(values: Mapping[str, object], problems: list[str]) -> tuple[float, float] | None:
    """Return latitude and longitude of the origin, where both are given and a place."""
    found = [_number(values, name, problems) for name in PLACE]
    if (PLACE[0] in values) != (PLACE[1] in values):
        problems.append("half of a place is given; give latitude_deg and longitude_deg")
    if found[0] is None or found[1] is None:
        return None
    try:
        Datum(found[0], found[1])
    except ValueError as error:
        problems.append(str(error))
    return found[0], found[1]


def _number(values: Mapping[str, object], name: str, problems: list[str]) -> float | None:
    if name not in values:
        return None
    try:
        value = float(str(values[name]))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        problems.append(f"{name} {values[name]!r} is no number")
        return None
    if name in RANGE and value != int(value):
        problems.append(f"{name} {values[name]!r} is no whole number of px")
    return value
