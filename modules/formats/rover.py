"""The vehicle that shall drive on the terrain, as YAML."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path

from modules.formats._text import number, read_mapping, read_text
from modules.formats.errors import FormatError
from modules.types import Rover

LIMITS = {
    "wheel_radius_m": (0.001, 2.0),
    "clearance_m": (0.001, 5.0),
    "width_m": (0.001, 10.0),
    "max_tilt_deg": (0.1, 60.0),
    "body_front_m": (0.0, 20.0),
    "body_back_m": (0.0, 20.0),
    "min_confidence": (0.0, 1.0),
    "min_grazing_deg": (0.0, 45.0),
}


def read_rover(path: Path | str) -> Rover:
    """Read the fields of `Rover`; what is left out has its default.

    Raises
    ------
    FormatError
        The file is missing or no such YAML, or values are out of range; all of them are told.
    """
    path = Path(path)
    stated = read_mapping(path, read_text(path, "rover"), "rover", [field.name for field in fields(Rover)])
    values = {name: number(path, stated, name, default) for name, default in asdict(Rover()).items()}
    wrong = [
        f"{name} is {value:g} and must be {LIMITS[name][0]:g} to {LIMITS[name][1]:g}"
        for name, value in values.items()
        if not LIMITS[name][0] <= value <= LIMITS[name][1]
    ]
    if wrong:
        raise FormatError(f"{path}: {'; '.join(wrong)}; lengths are in metres, angles in degrees")
    return Rover(**values)
