"""Names, units and meanings of the layers of an elevation map; written once, here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Layer:
    """Unit (`1` for none) and meaning of a layer."""

    unit: str
    meaning: str


LAYERS: Mapping[str, Layer] = MappingProxyType(
    {
        "elevation": Layer("m", "height above the level plane through the origin"),
        "sigma_m": Layer("m", "standard deviation of the elevation"),
        "variance_m2": Layer("m2", "variance of the heights of the points in the cell"),
        "median_m": Layer("m", "median of the heights"),
        "min_m": Layer("m", "lowest point"),
        "max_m": Layer("m", "highest point"),
        "count": Layer("1", "points in the cell, outliers not counted"),
        "age_s": Layer("s", "time since the cell was last measured"),
        "filled": Layer("1", "1 where the elevation was interpolated"),
        "slope_deg": Layer("deg", "tilt of the plane through the patch about the cell"),
        "roughness_m": Layer("m", "root mean square distance of the patch from its plane"),
        "step_m": Layer("m", "highest less lowest cell of the patch"),
        "normal_x": Layer("1", "upward unit normal of the patch, x"),
        "normal_y": Layer("1", "upward unit normal of the patch, y"),
        "normal_z": Layer("1", "upward unit normal of the patch, z"),
        "sight": Layer("1", "0 out of view, 1 measured, 2 hidden by nearer terrain, 3 in view but not measured"),
        "hazard": Layer("1", "0 none, 1 step, 2 roughness, 3 slope at the cell itself, 255 unknown"),
        "goodness": Layer("1", "1 safe to 0 hazard, of the cell itself"),
        "traversability": Layer("1", "1 safe to 0 hazard, of the rover standing on the cell"),
        "limiting_hazard": Layer("1", "hazard that limits it: as hazard, and 4 unknown ground under the rover"),
        "moving": Layer("1", "1 where views of a sequence disagree beyond their uncertainty"),
        "views": Layer("1", "views of a sequence that measured the cell"),
    }
)


def unit_of(name: str) -> str:
    """Return the unit of a layer; `1` for one that is not listed."""
    return LAYERS[name].unit if name in LAYERS else "1"
