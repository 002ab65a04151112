"""Shapes, units and conventions shared by all modules; written once, here.

Images are `(H, W)` gray or `(H, W, 3)` RGB, uint8 or uint16. Arrays are indexed row, column. A quantity in `_dn` is on
the 0-255 scale whatever the bit depth. Disparity is left column minus right column, in pixels of the left image; a
point at infinity has disparity `-doffs`. Lengths are metres; angles are radians inside and degrees at the edge.

Frames follow ROS REP 103. Camera optical: x right, y down, z forward. Body and level: x forward, y left, z up. Positive
roll lowers the right side, positive pitch lowers the nose, positive yaw turns left.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum, IntFlag
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
Mask: TypeAlias = NDArray[np.bool_]
FloatImage: TypeAlias = NDArray[np.float32]
Side: TypeAlias = Literal["left", "right"]


def full_scale(image: Image) -> int:
    """Return the largest value of the image's dtype, 255 or 65535."""
    return int(np.iinfo(image.dtype).max)


def dn_scale(image: Image) -> float:
    """Return the stored levels per DN: 1 for 8 bit, 257 for 16 bit."""
    return full_scale(image) / 255.0


@dataclass(frozen=True)
class Correspondences:
    """Corresponding points of a pair.

    Attributes
    ----------
    left_xy, right_xy : float32 (N, 2)
        Column and row of each point in px.
    """

    left_xy: NDArray[np.float32]
    right_xy: NDArray[np.float32]

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.left_xy)


@dataclass(frozen=True)
class Views:
    """The two images of a pair on their way through correction.

    Attributes
    ----------
    left, right : (H, W) or (H, W, 3), uint8 or uint16
        Images of one shape and dtype. Disparity always refers to the geometry of the original left image: operators
        that align rows warp the right image.
    left_mask, right_mask : bool (H, W) or None
        True where the pixel may be used; None means everywhere.
    correspondences : Correspondences or None
        Sparse matches, where a probe has measured them.
    """

    left: Image
    right: Image
    left_mask: Mask | None = None
    right_mask: Mask | None = None
    correspondences: Correspondences | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return int(self.left.shape[0]), int(self.left.shape[1])

    def with_images(self, left: Image, right: Image) -> Views:
        """Return the same views with other images."""
        return replace(self, left=left, right=right)


@dataclass(frozen=True)
class DisparityRange:
    """Disparities to search, in whole px: `min_px <= d < max_px`, like a Python range."""

    min_px: int
    max_px: int

    def __post_init__(self) -> None:
        if self.max_px <= self.min_px:
            raise ValueError(
                f"disparity range {self.min_px} {self.max_px} is empty; the second number must be larger than the first"
            )

    @property
    def count(self) -> int:
        """Number of disparities searched."""
        return self.max_px - self.min_px


class Invalid(IntFlag):
    """Reasons why a pixel has no disparity; 0 means valid. Stored as uint16."""

    NO_MATCH = 1  # the matcher gave no disparity and no narrower reason
    MASKED = 2  # excluded by a mask of the pair
    OUTSIDE = 4  # its match would lie outside the right image
    RANGE_BORDER = 8  # the best disparity is at an end of the searched range
    LEFT_RIGHT = 16  # the match of the match is another pixel
    NOT_UNIQUE = 32  # a second disparity is nearly as good
    FLAT_MINIMUM = 64  # the cost hardly depends on the disparity
    SPECKLE = 128  # part of a small island of similar disparity
    SATURATED = 256  # clipped in either image
    TEXTURELESS = 512  # too little texture to decide
    LOW_CONFIDENCE = 1024  # below the confidence limit
    SKY = 2048  # sky, no terrain
    FILLED = 4096  # in a filled product only: the value was interpolated


@dataclass(frozen=True)
class Disparity:
    """A disparity map of the left image.

    Attributes
    ----------
    disparity_px : float32 (H, W)
        Left column minus right column, px; NaN where invalid.
    validity : uint16 (H, W)
        `Invalid` flags; 0 where valid.
    confidence : float32 (H, W) or None
        Predicted probability that the error is below 1 px, 0-1.
    sigma_px : float32 (H, W) or None
        Predicted standard deviation of the disparity, px.
    right_px : float32 (H, W) or None
        Disparity of the right image (same sign convention, indexed by right column), for consistency checks.
    excess : float32 (H, W) or None
        How much the second best cost exceeds the best one, relative to it, where the matcher knows; NaN where the cost
        is flat. Evidence for the confidence, not a probability.
    """

    disparity_px: FloatImage
    validity: NDArray[np.uint16]
    confidence: FloatImage | None = None
    sigma_px: FloatImage | None = None
    right_px: FloatImage | None = None
    excess: FloatImage | None = None

    @property
    def valid(self) -> Mask:
        """True where the pixel has a disparity."""
        return np.isfinite(self.disparity_px)

    def reject(self, where: Mask, reason: Invalid) -> Disparity:
        """Return a copy with the valid pixels of `where` made invalid for `reason`."""
        drop = where & self.valid
        disparity = np.where(drop, np.float32(np.nan), self.disparity_px)
        validity = np.where(drop, self.validity | np.uint16(reason), self.validity).astype(np.uint16)
        return replace(self, disparity_px=disparity, validity=validity)

    def rejected(self) -> dict[str, int]:
        """Count the invalid pixels by reason."""
        counts = {flag.name or "": int(np.count_nonzero(self.validity & flag.value)) for flag in Invalid}
        return {name: count for name, count in counts.items() if count}


@dataclass(frozen=True)
class Matching:
    """State of the matching stage: what its operators take and return.

    `filled` is a product beside the disparity, for display: its filled pixels have a value, `Invalid.FILLED` and no
    confidence. Nothing is reconstructed from it.
    """

    views: Views
    range_px: DisparityRange | None = None
    disparity: Disparity | None = None
    filled: Disparity | None = None


@dataclass(frozen=True)
class Calibration:
    """Geometry of a rectified pair.

    Depth is `Z = focal_px * baseline_m / (d + doffs_px)`, where doffs is the right principal point's column minus the
    left one's. Pixel (column u, row v) of the left image looks along `((u - cx) / f, (v - cy) / f, 1)`.
    """

    focal_px: float
    cx_px: float
    cy_px: float
    baseline_m: float
    width_px: int
    height_px: int
    doffs_px: float = 0.0


@dataclass(frozen=True)
class Camera:
    """One camera as it is, before rectification.

    Attributes
    ----------
    focal_px, centre_px : (float, float)
        Along columns and rows; pixel centres have whole coordinates.
    width_px, height_px : int
    distortion : tuple of float
        Coefficients of `model`; empty for none.
    model : {"radtan", "equidistant"}
        `radtan` is Brown's (k1, k2, p1, p2[, k3[, k4, k5, k6[, ...]]], the order of OpenCV), `equidistant` the fisheye
        model of Kannala and Brandt (k1, k2, k3, k4).
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    width_px: int
    height_px: int
    distortion: tuple[float, ...] = ()
    model: Literal["radtan", "equidistant"] = "radtan"

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Camera matrix (3, 3)."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Rectification:
    """How two cameras are turned into a parallel rig: `p_rectified = rotation @ p_optical` for each.

    Attributes
    ----------
    left_rotation, right_rotation : float64 (3, 3)
    calibration : Calibration
        Of the rectified pair.
    """

    left_rotation: NDArray[np.float64]
    right_rotation: NDArray[np.float64]
    calibration: Calibration


@dataclass(frozen=True)
class StereoRig:
    """Two cameras as they are: `p_right = rotation @ p_left + translation_m`, both optical.

    Attributes
    ----------
    left, right : Camera
    rotation : float64 (3, 3)
    translation_m : (float, float, float)
        The first component is negative where the right camera stands to the right.
    rectification : Rectification or None
        The one that the calibration file prescribes; None leaves the choice.
    """

    left: Camera
    right: Camera
    rotation: NDArray[np.float64]
    translation_m: tuple[float, float, float]
    rectification: Rectification | None = None


@dataclass(frozen=True)
class Attitude:
    """Attitude of the body: `p_level = Rz(yaw) Ry(pitch) Rx(roll) p_body`, radians, REP 103."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    sigma_rad: float = 0.0  # standard deviation of roll and pitch


@dataclass(frozen=True)
class Pose:
    """Where the body stands in a map: `p_map = Rz(yaw) Ry(pitch) Rx(roll) p_body + translation_m`.

    Attributes
    ----------
    attitude : Attitude
    translation_m : (float, float, float)
        The body's origin in the level frame of the map, or east, north, up where yaw counts from east.
    sigma_m : float
        Standard deviation of each component of the translation, m.
    """

    attitude: Attitude = field(default_factory=Attitude)
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sigma_m: float = 0.0


@dataclass(frozen=True)
class Mount:
    """Where the left camera sits: `p_body = rotation @ p_optical + translation_m`.

    The default looks forward along body x from the origin of the body frame.
    """

    rotation: NDArray[np.float64] = field(
        default_factory=lambda: np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    )
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


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
