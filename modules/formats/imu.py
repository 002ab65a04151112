"""Logs of an inertial measurement unit: CSV with timestamps."""

from __future__ import annotations

import csv
import io
import itertools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from modules.formats._text import finite, read_text
from modules.formats.attitude import (
    attitude_from_degrees,
    attitude_from_gravity,
    attitude_from_rotation,
    in_degrees,
    quaternion_rotation,
)
from modules.formats.errors import FormatError
from modules.primitives.frames import Convention, level_from_body
from modules.types import Attitude

MAX_GAP_S = 0.5  # between the records on both sides of an interpolated time; loggers of 5 Hz and more pass
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
TIME_NAMES = {f"{name}_{unit}": scale for name in ("time", "timestamp") for unit, scale in TIME_UNITS.items()}
QUATERNION = ("qw", "qx", "qy", "qz")
EUROC_QUATERNION = {"q_rs_w", "q_rs_x", "q_rs_y", "q_rs_z"}
DEGREES, RADIANS = ("roll_deg", "pitch_deg", "yaw_deg"), ("roll_rad", "pitch_rad", "yaw_rad")
ACCELEROMETER = ("ax_mps2", "ay_mps2", "az_mps2")
FORMS = (QUATERNION, DEGREES, RADIANS, ACCELEROMETER)
MAX_LISTED = 5  # faulty lines named in one message


@dataclass(frozen=True)
class ImuLog:
    """Attitudes over time.

    Attributes
    ----------
    name : str
        For messages.
    time_s : float64 (N,)
        Strictly increasing.
    level_from_body : float64 (N, 3, 3)
        Rotations, REP 103.
    """

    name: str
    time_s: NDArray[np.float64]
    level_from_body: NDArray[np.float64]

    def at(
        self, time_s: float, *, method: Literal["interpolate", "nearest"] = "interpolate", max_gap_s: float = MAX_GAP_S
    ) -> Attitude:
        """Return the attitude at a time.

        Parameters
        ----------
        time_s : float
            On the clock of the log, s.
        method : {"interpolate", "nearest"}
            Spherical linear interpolation between the records on both sides, or the nearest record.
        max_gap_s : float
            Largest distance of those two records (or of the nearest one), s.

        Raises
        ------
        FormatError
            Outside the log, or inside a gap.

        References
        ----------
        K. Shoemake, Animating rotation with quaternion curves, SIGGRAPH 1985.
        """
        first, last = float(self.time_s[0]), float(self.time_s[-1])
        if not first <= time_s <= last:
            raise FormatError(
                f"{self.name} runs from {first:.3f} to {last:.3f} s and {time_s:.3f} s is outside; "
                "check that the images and the log use one clock and unit"
            )
        after = int(np.searchsorted(self.time_s, time_s))
        before = after if self.time_s[after] == time_s else after - 1
        gap = float(self.time_s[after] - self.time_s[before])
        nearest = before if time_s - self.time_s[before] <= self.time_s[after] - time_s else after
        if method == "nearest":
            gap = abs(float(self.time_s[nearest]) - time_s)
        if gap > max_gap_s:
            raise FormatError(
                f"{self.name} has a gap of {gap:.3f} s at {time_s:.3f} s, above {max_gap_s:g} s; "
                "the attitude may have changed meanwhile: take another pair, or allow the gap (--max-gap, max_gap_s)"
            )
        rotation = self.level_from_body[nearest]
        if method == "interpolate" and after != before:
            rotation = self._between(before, after, time_s)
        return attitude_from_rotation(f"{self.name} at {time_s:.3f} s", rotation)

    def _between(self, before: int, after: int, time_s: float) -> NDArray[np.float64]:
        from scipy.spatial.transform import Rotation, Slerp  # a third of a second to import

        pair = [before, after]
        curve = Slerp(self.time_s[pair], Rotation.from_matrix(self.level_from_body[pair]))
        return np.asarray(curve([time_s]).as_matrix()[0])


def read_imu_log(path: Path | str, convention: Convention = "rep103") -> ImuLog:
    """Read the log of an inertial measurement unit.

    Parameters
    ----------
    path : Path or str
        CSV whose first line names the columns: `time_s` (or `timestamp_s`, `_ms`, `_us`, `_ns`), and one of `qw`, `qx`,
        `qy`, `qz`; `roll_deg`, `pitch_deg`, `yaw_deg` (or `_rad`); `ax_mps2`, `ay_mps2`, `az_mps2` of a body at rest.
        Other columns are ignored. The names of EuRoC's ground truth are known, too (`timestamp`, `q_RS_w []`).
    convention : {"rep103", "aerospace", "euroc"}
        Axes of the log; see `read_attitude`.

    Raises
    ------
    FormatError
        With the numbers of the lines that are wrong: no number, out of order, no rotation.
    """
    path = Path(path)
    rows = list(csv.reader(io.StringIO(read_text(path, "log", max_bytes=500_000_000))))
    if not rows:
        raise FormatError(f"{path} is empty; a log begins with the names of its columns")
    header = _names(rows[0])
    time_name = next((name for name in header if name in TIME_NAMES), None)
    form = next((names for names in FORMS if set(names) <= set(header)), None)
    if time_name is None or form is None:
        raise FormatError(
            f"{path} has the columns {', '.join(header)}; it needs a time (time_s, timestamp_ns, ...) and "
            f"{' or '.join(', '.join(names) for names in FORMS)}"
        )
    columns = [header.index(name) for name in (time_name, *form)]
    times, rotations = [], []
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        if len(row) < len(header):
            raise FormatError(f"{path}:{line}: {len(row)} columns and the first line names {len(header)}; complete it")
        values = [finite(f"{path}:{line}", header[column], row[column].strip()) for column in columns]
        times.append((line, values[0] * TIME_NAMES[time_name]))
        rotations.append(_rotation(f"{path}:{line}", form, values[1:], convention))
    if not times:
        raise FormatError(f"{path} has no records after its first line; log while the images are taken")
    _check_order(path, times)
    return ImuLog(str(path), np.array([time for _, time in times]), np.array(rotations))


def _names(row: list[str]) -> list[str]:
    """Return the names of the columns, those of EuRoC's ground truth under ours: its times are in ns, `q_RS` is one."""
    names = [name.strip().lstrip("#").strip().lower() for name in row]
    if {name.partition(" ")[0] for name in names} >= EUROC_QUATERNION:
        names = [name.partition(" ")[0].replace("q_rs_", "q") for name in names]
        return ["timestamp_ns" if name == "timestamp" else name for name in names]
    return [re.sub(r" \[([mun]?s)\]$", r"_\1", name) for name in names]


def _rotation(source: str, form: tuple[str, ...], values: list[float], convention: Convention) -> NDArray[np.float64]:
    if form == ACCELEROMETER:
        return level_from_body(attitude_from_gravity(source, np.array(values), convention))
    if form == QUATERNION:
        attitude = attitude_from_rotation(source, quaternion_rotation(source, *values), convention)
        return level_from_body(attitude)
    roll, pitch, yaw = (in_degrees(source, name, value) for name, value in zip(form, values, strict=True))
    return level_from_body(attitude_from_degrees(roll, pitch, yaw, convention=convention, source=source))


def _check_order(path: Path, times: list[tuple[int, float]]) -> None:
    wrong = [
        (line, time, before)
        for (_, before), (line, time) in itertools.pairwise(times)
        if time <= before
    ]  # fmt: skip
    if not wrong:
        return
    named = "; ".join(f"line {line}: {time:.6f} s after {before:.6f} s" for line, time, before in wrong[:MAX_LISTED])
    more = f" and {len(wrong) - MAX_LISTED} more" if len(wrong) > MAX_LISTED else ""
    raise FormatError(f"{path}: timestamps are out of order ({named}{more}); sort the log and remove doubles")
