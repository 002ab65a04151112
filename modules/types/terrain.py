"""Points, elevation maps, and what drives on them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from modules.types.cameras import Calibration
from modules.types.disparity import Disparity
from modules.types.images import Image, Mask
from modules.types.poses import Attitude, Mount


@dataclass(frozen=True)
class SharedError:
    """Errors that all points of a cloud share, so that no averaging removes them.

    Attributes
    ----------
    pivot_m : (float, float, float)
        Point about which an error of the attitude turns the cloud: the body origin, in the frame of the cloud.
    camera_m : (float, float, float)
        Left camera in that frame.
    axis : (float, float, float)
        Its optical axis, unit vector.
    tilt_rad : float
        Standard deviation of roll and of pitch.
    scale : float
        Relative standard deviation of focal length times baseline.
    offset_per_m : float
        Standard deviation of the disparity offset over focal length times baseline, 1/m.
    """

    pivot_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    tilt_rad: float = 0.0
    scale: float = 0.0
    offset_per_m: float = 0.0


@dataclass(frozen=True)
class PointCloud:
    """Points of the terrain.

    Attributes
    ----------
    xyz_m : float32 (N, 3)
        Coordinates in `frame`.
    frame : str
        `optical`, `body`, `level` or `enu`.
    rgb : uint8 (N, 3) or None
    pixel : int32 (N,)
        Flat index of each point's pixel in the left image.
    covariance_m2 : float32 (N, 6) or None
        xx, xy, xz, yy, yz, zz; the whole uncertainty, the shared part included.
    shared : SharedError
        The part of it that all points share.
    """

    xyz_m: NDArray[np.float32]
    frame: str
    pixel: NDArray[np.int32]
    rgb: NDArray[np.uint8] | None = None
    covariance_m2: NDArray[np.float32] | None = None
    shared: SharedError = field(default_factory=SharedError)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.xyz_m)

    def select(self, keep: Mask) -> PointCloud:
        """Return the points where `keep` (N,) is true."""
        kept = np.flatnonzero(keep)  # taking by number is several times faster than by a mask
        return replace(
            self,
            xyz_m=self.xyz_m.take(kept, axis=0),
            pixel=self.pixel.take(kept),
            rgb=None if self.rgb is None else self.rgb.take(kept, axis=0),
            covariance_m2=None if self.covariance_m2 is None else self.covariance_m2.take(kept, axis=0),
        )


@dataclass(frozen=True)
class ElevationMap:
    """Named layers on one grid of the level frame.

    Cell (i, j) covers x from `x0_m + j * cell_m` and y from `y0_m + i * cell_m`, one cell wide. `layers["elevation"]`
    is z in metres; other layers are named after the quantity and its unit (`modules.primitives.layers`). NaN marks
    unknown cells of float layers.
    """

    x0_m: float
    y0_m: float
    cell_m: float
    layers: dict[str, NDArray[np.generic]]
    frame: str = "level"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (y) and columns (x)."""
        rows, columns = self.layers["elevation"].shape
        return int(rows), int(columns)


@dataclass(frozen=True)
class Scene:
    """State of the reconstruction stage: what its operators take and return."""

    disparity: Disparity
    left: Image
    calibration: Calibration | None = None
    attitude: Attitude | None = None
    mount: Mount = field(default_factory=Mount)
    points: PointCloud | None = None
    elevation: ElevationMap | None = None
    mask: Mask | None = None  # True where the left pixel may show terrain: no sky, no part of the robot
    rejected: dict[str, int] = field(default_factory=dict)  # points dropped, by reason
    ground: GroundPlane | None = None  # fitted where the attitude is unknown


@dataclass(frozen=True)
class Datum:
    """Where the origin of a local east-north-up frame lies, WGS 84."""

    latitude_deg: float
    longitude_deg: float

    def __post_init__(self) -> None:
        if not (-90.0 <= self.latitude_deg <= 90.0 and -180.0 <= self.longitude_deg <= 180.0):
            raise ValueError(
                f"datum {self.latitude_deg:g} {self.longitude_deg:g} is no place; "
                "give latitude -90 to 90 and longitude -180 to 180, in degrees"
            )


@dataclass(frozen=True)
class Rover:
    """The vehicle that shall drive on the terrain; the defaults are a rover as wide as a person."""

    wheel_radius_m: float = 0.115  # it climbs steps up to this
    clearance_m: float = 0.25  # height of the belly above the ground
    width_m: float = 0.8
    max_tilt_deg: float = 20.0
    body_front_m: float = 0.0  # it reaches this far ahead of the body origin; points within it are its own
    body_back_m: float = 0.0
    min_confidence: float = 0.0  # it drives on points that are right with at least this probability
    min_grazing_deg: float = 0.0  # and that were seen at no flatter angle to the ground


class Hazard(IntEnum):
    """What makes a cell of an elevation map untraversable."""

    NONE = 0
    STEP = 1  # an edge higher than the rover climbs
    ROUGHNESS = 2  # ground that reaches the belly
    SLOPE = 3  # a tilt beyond the limit
    BORDER = 4  # unknown ground under the rover
    UNKNOWN = 255  # the cell itself is unknown


class Sight(IntEnum):
    """What the camera could tell of a cell of an elevation map."""

    OUT_OF_VIEW = 0
    MEASURED = 1
    OCCLUDED = 2  # nearer terrain hides it
    UNMATCHED = 3  # in view, but nothing was measured there


@dataclass(frozen=True)
class GroundPlane:
    """A plane fitted to the terrain, from which roll and pitch follow when no attitude was measured."""

    normal: tuple[float, float, float]
    height_m: float
    sigma_tilt_rad: float
    residual_m: float
    inlier_fraction: float
