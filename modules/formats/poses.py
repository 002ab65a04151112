"""Poses of a sequence, as CSV."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

from modules.formats._text import read_text
from modules.formats.errors import FormatError
from modules.types import Attitude, Pose

NEEDED = ("name", "time_s", "x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg")
OPTIONAL = ("sigma_m", "sigma_deg")


@dataclass(frozen=True)
class StampedPose:
    """The pose of one view."""

    name: str
    time_s: float
    pose: Pose


def read_poses(path: Path | str) -> list[StampedPose]:
    """Read a CSV of poses, one line per view.

    The header names the columns `name`, `time_s`, `x_m`, `y_m`, `z_m`, `roll_deg`, `pitch_deg`, `yaw_deg` and,
    optional, `sigma_m` and `sigma_deg`. Angles follow ROS REP 103; x, y, z is the origin of the body in the map.

    Raises
    ------
    FormatError
        The file is missing or empty, columns are missing or unknown, a value is no finite number, a name occurs twice,
        or time runs backwards; all faults of the rows are told.
    """
    path = Path(path)
    rows = list(csv.DictReader(read_text(path, "pose file").splitlines(), skipinitialspace=True))
    columns = list(rows[0]) if rows else []
    if not rows:
        raise FormatError(f"{path} has no poses; write the header {','.join(NEEDED)} and one line per view")
    missing = [name for name in NEEDED if name not in columns]
    unknown = [str(name) for name in columns if name not in (*NEEDED, *OPTIONAL)]
    if missing or unknown:
        said = ([f"lacks {', '.join(missing)}"] if missing else []) + (
            [f"has unknown columns {', '.join(unknown)}"] if unknown else []
        )
        raise FormatError(f"{path} {' and '.join(said)}; the columns are {', '.join((*NEEDED, *OPTIONAL))}")
    problems: list[str] = []
    poses: list[StampedPose] = []
    for line, row in enumerate(rows, start=2):
        values = {name: _value(row.get(name) or "0") for name in (*NEEDED[1:], *OPTIONAL)}
        wrong = [name for name, value in values.items() if not math.isfinite(value)]
        problems += [f"line {line}: {name} is {row.get(name)!r} and must be a finite number" for name in wrong]
        if wrong:
            continue
        if any(pose.name == row["name"] for pose in poses):
            problems.append(f"line {line}: the name {row['name']} occurs twice")
        if poses and values["time_s"] < poses[-1].time_s:
            problems.append(
                f"line {line}: time {values['time_s']:g} s is before {poses[-1].time_s:g} s; sort the lines"
            )
        for name in ("roll_deg", "pitch_deg"):
            if abs(values[name]) > 90.0:
                problems.append(f"line {line}: {name} is {values[name]:g}, beyond 90; give degrees")
        attitude = Attitude(*(math.radians(values[f"{name}_deg"]) for name in ("roll", "pitch", "yaw", "sigma")))
        place = (values["x_m"], values["y_m"], values["z_m"])
        poses.append(StampedPose(row["name"], values["time_s"], Pose(attitude, place, values["sigma_m"])))
    if problems:
        raise FormatError(f"{path}: {'; '.join(problems)}")
    return poses


def _value(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
