"""Render a stereo pair of a synthetic rocky terrain, with exact disparity and elevation."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import OperatorParams
from modules.primitives.frames import level_from_body, rotation_from_angles
from modules.simulation.heightfield import LIMIT_M, Heightfield, build_heightfield
from modules.types import Attitude, Calibration, ElevationMap, FloatImage, Mask, Mount

FloatArray = NDArray[np.float64]

SOIL = np.array([0.56, 0.33, 0.19])  # linear reflectance, R G B: ferric dust
ROCK = np.array([0.36, 0.25, 0.19])
SKY_LOW = np.array([0.80, 0.64, 0.47])
SKY_HIGH = np.array([0.56, 0.43, 0.32])
HAZE_M = 300.0  # distance over which haze covers 63 % of the terrain
DISPLAY_GAMMA = 2.2


class TerrainParams(OperatorParams):
    """Parameters of `render_terrain`; the default cameras stand 1 m above the ground and look 15 degrees down."""

    seed: int = Field(0, ge=0, description="Seed of the terrain; equal parameters give equal bits")
    width_px: int = Field(640, ge=16, le=4096, description="Image width, px")
    height_px: int = Field(480, ge=16, le=4096, description="Image height, px")
    focal_px: float = Field(500.0, gt=0, le=20000, description="Focal length, px")
    baseline_m: float = Field(0.09, gt=0, le=2, description="Distance of the cameras, m")
    camera_height_m: float = Field(1.0, ge=0.2, le=5, description="Height of the left camera above the body origin, m")
    camera_tilt_deg: float = Field(15.0, ge=-30, le=80, description="Downward tilt of the cameras in the body, deg")
    roll_deg: float = Field(0.0, ge=-45, le=45, description="Roll of the body, deg; positive lowers the right side")
    pitch_deg: float = Field(0.0, ge=-45, le=45, description="Pitch of the body, deg; positive lowers the nose")
    yaw_deg: float = Field(
        0.0, ge=-180, le=180, description="Yaw of the body, deg; positive turns left; terrain and sun turn with it"
    )
    roughness_m: float = Field(0.025, ge=0, le=0.2, description="Standard deviation of the ground below 2 m wavelength")
    relief_m: float = Field(0.12, ge=0, le=1, description="Standard deviation of the ground at 4 to 40 m wavelength")
    hills_m: float = Field(6.0, ge=0, le=40, description="Height scale of the hills beyond 40 m")
    rock_abundance: float = Field(0.10, ge=0, le=0.5, description="Fraction of the area covered by rocks, 0-1")
    smallest_rock_m: float = Field(0.04, ge=0.03, le=0.5, description="Diameter of the smallest rocks, m")
    largest_rock_m: float = Field(1.0, ge=0.03, le=2, description="Diameter of the largest rocks, m")
    sun_azimuth_deg: float = Field(65.0, ge=-180, le=180, description="Sun from straight ahead, positive left, deg")
    sun_elevation_deg: float = Field(38.0, ge=5, le=89, description="Elevation of the sun, deg")
    ambient: float = Field(0.22, ge=0, le=1, description="Fraction of the light that comes from the sky")
    texture: float = Field(0.12, ge=0, le=0.5, description="Standard deviation of the log reflectance per octave")
    supersample: int = Field(2, ge=1, le=4, description="Rays per pixel and axis")
    cell_m: float = Field(0.05, ge=0.01, le=1, description="Cell of the true elevation map, m")
    range_m: float = Field(8.0, gt=0, le=15, description="The true elevation map reaches this far ahead, m")


@dataclass(frozen=True)
class RenderedPair:
    """A rendered pair with its truth.

    Attributes
    ----------
    left, right : uint8 (H, W, 3)
        RGB images.
    disparity_px : float32 (H, W)
        True disparity of the centre of each left pixel; NaN for sky.
    occluded : bool (H, W)
        True where terrain of the left image is hidden in the right image or outside it.
    elevation : ElevationMap
        True terrain in the level frame; see `true_elevation`.
    calibration, mount, attitude
        Geometry of the pair.
    heightfield : Heightfield
        The surface itself, in the heading frame: the level frame turned by yaw.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    disparity_px: FloatImage
    occluded: Mask
    elevation: ElevationMap
    calibration: Calibration
    mount: Mount
    attitude: Attitude
    heightfield: Heightfield

    @property
    def sky(self) -> Mask:
        """True where the left image shows no terrain."""
        return np.isnan(self.disparity_px)

    @property
    def nonocc(self) -> Mask:
        """True where the left pixel shows terrain that the right image shows as well."""
        return ~self.occluded & ~self.sky

    def height_m(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return the true height in m at points of the level frame."""
        x, y = _turn(np.asarray(x_m, np.float64), np.asarray(y_m, np.float64), -self.attitude.yaw_rad)
        return self.heightfield.height_m(x, y)

    def true_elevation(self, x0_m: float, y0_m: float, cell_m: float, shape: tuple[int, int]) -> ElevationMap:
        """Average the visible terrain in each cell of any grid of the level frame.

        Parameters
        ----------
        x0_m, y0_m : float
            Corner of cell (0, 0), m.
        cell_m : float
            Size of a cell, m.
        shape : (int, int)
            Rows (y) and columns (x).

        Returns
        -------
        ElevationMap
            Layers `elevation` (m, mean over the part of the cell that the left camera sees; NaN where it sees
            nothing) and `visible_fraction` (0-1), both float32.

        Raises
        ------
        ValueError
            If the cell or the shape is not positive.
        """
        if cell_m <= 0 or min(shape) <= 0:
            raise ValueError(f"cell {cell_m} m and shape {shape} must be positive")
        fine = int(np.clip(np.ceil(cell_m / 0.0125), 2, 8))  # samples per cell and axis, near the grid of the terrain
        x = x0_m + (np.arange(shape[1] * fine) + 0.5) * cell_m / fine
        y = y0_m + (np.arange(shape[0] * fine) + 0.5) * cell_m / fine
        level = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1).reshape(-1, 3)
        level[:, 2] = self.height_m(level[:, 0], level[:, 1])
        seen = self._visible(level).reshape(shape[0], fine, shape[1], fine)
        heights = level[:, 2].reshape(seen.shape)
        count = seen.sum(axis=(1, 3))
        total = np.where(seen, heights, 0.0).sum(axis=(1, 3))
        elevation = np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)
        fraction = (count / fine**2).astype(np.float32)
        return ElevationMap(x0_m, y0_m, cell_m, {"elevation": elevation, "visible_fraction": fraction})

    def _visible(self, level: FloatArray) -> Mask:
        """Return whether the left camera sees surface points (N, 3) of the level frame."""
        rotation, centre = _camera(self.mount, self.attitude)
        optical = (level - centre) @ rotation
        depth = np.maximum(optical[:, 2], 1e-6)
        c = self.calibration
        u = c.focal_px * optical[:, 0] / depth + c.cx_px
        v = c.focal_px * optical[:, 1] / depth + c.cy_px
        seen = (optical[:, 2] > 0.05) & (u >= -0.5) & (u < c.width_px - 0.5) & (v >= -0.5) & (v < c.height_px - 0.5)
        heading = _heading(self.attitude)
        seen[seen] = self.heightfield.sees(heading @ centre, level[seen] @ heading.T)
        return seen


def render_terrain(params: TerrainParams) -> RenderedPair:
    """Render a rocky heightfield from two cameras by ray casting.

    Parameters
    ----------
    params : TerrainParams
        Rig, attitude, terrain and light.

    Returns
    -------
    RenderedPair
        Two RGB images (H, W, 3), uint8, with exact disparity, occlusion and elevation. The level frame has its origin
        at the origin of the body, on the ground under the left camera.

    Raises
    ------
    ValueError
        If the smallest rock is larger than the largest.

    Notes
    -----
    The terrain ends 170 m ahead. Finer texture than a pixel is faded out, and each pixel is the mean of
    `supersample` x `supersample` rays, so that the images are not aliased. There is no noise: see
    `modules.simulation.sensor`.

    Examples
    --------
    >>> pair = render_terrain(TerrainParams(width_px=64, height_px=48, focal_px=50))
    >>> pair.left.shape, bool(pair.nonocc.any())
    ((48, 64, 3), True)
    """
    if params.smallest_rock_m > params.largest_rock_m:
        raise ValueError(
            f"smallest_rock_m {params.smallest_rock_m} is above largest_rock_m {params.largest_rock_m}; exchange them"
        )
    field = build_heightfield(
        params.seed,
        params.roughness_m,
        params.relief_m,
        params.hills_m,
        params.rock_abundance,
        (params.smallest_rock_m, params.largest_rock_m),
        float(np.radians(params.sun_azimuth_deg)),
        float(np.radians(params.sun_elevation_deg)),
        params.ambient,
    )
    width, height = params.width_px, params.height_px
    calibration = Calibration(params.focal_px, (width - 1) / 2, (height - 1) / 2, params.baseline_m, width, height)
    tilt = float(np.radians(params.camera_tilt_deg))
    mount = Mount(rotation_from_angles(0.0, tilt, 0.0) @ Mount().rotation, (0.0, 0.0, params.camera_height_m))
    attitude = Attitude(*(float(np.radians(a)) for a in (params.roll_deg, params.pitch_deg, params.yaw_deg)))

    rotation, centre = _camera(mount, attitude)
    heading = _heading(attitude)
    rotation, centre = heading @ rotation, heading @ centre
    right_centre = centre + rotation[:, 0] * params.baseline_m

    directions, lengths = _rays(calibration, rotation, 0.0, 0.0)
    distance = field.cast(centre, directions)
    depth = distance / lengths
    disparity = np.where(np.isfinite(depth), params.focal_px * params.baseline_m / depth, np.nan)
    occluded = np.isfinite(depth)
    points = centre + directions[occluded] * distance[occluded, None]
    column = np.tile(np.arange(width, dtype=np.float64), height)[occluded] - disparity[occluded]
    hidden = (column < 0) | (column > width - 1) | ~field.sees(right_centre, points)
    occluded[occluded] = hidden

    right_distance = field.cast(right_centre, directions)
    with ThreadPoolExecutor(2) as pool:  # the kernels release the interpreter lock
        futures = [
            pool.submit(_image, field, calibration, rotation, eye, along, params)
            for eye, along in ((centre, distance), (right_centre, right_distance))
        ]
        left, right = (future.result() for future in futures)
    pair = RenderedPair(
        left,
        right,
        disparity.astype(np.float32).reshape(height, width),
        occluded.reshape(height, width),
        ElevationMap(0.0, 0.0, params.cell_m, {"elevation": np.zeros((1, 1), np.float32)}),
        calibration,
        mount,
        attitude,
        field,
    )
    return _with_elevation(pair, params.cell_m, params.range_m)


def _with_elevation(pair: RenderedPair, cell_m: float, range_m: float) -> RenderedPair:
    """Add the true map: the bounding box, in whole cells, of the square that reaches `range_m` ahead."""
    corners = np.array([[0, 0, range_m, range_m], [-range_m / 2, range_m / 2, -range_m / 2, range_m / 2]], float)
    x, y = _turn(corners[0], corners[1], pair.attitude.yaw_rad)
    low = np.floor(np.array([x.min(), y.min()]) / cell_m + 1e-6)
    high = np.ceil(np.array([x.max(), y.max()]) / cell_m - 1e-6)
    columns, rows = (high - low).astype(int)
    elevation = pair.true_elevation(float(low[0] * cell_m), float(low[1] * cell_m), cell_m, (int(rows), int(columns)))
    return replace(pair, elevation=elevation)


def _heading(attitude: Attitude) -> FloatArray:
    """Return the rotation from the level to the heading frame."""
    return rotation_from_angles(0.0, 0.0, -attitude.yaw_rad)


def _camera(mount: Mount, attitude: Attitude) -> tuple[FloatArray, FloatArray]:
    """Return the rotation from optical to level axes and the left camera's place in the level frame."""
    body = level_from_body(attitude)
    return body @ mount.rotation, body @ np.array(mount.translation_m)


def _turn(x: FloatArray, y: FloatArray, angle: float) -> tuple[FloatArray, FloatArray]:
    """Turn points about z."""
    c, s = np.cos(angle), np.sin(angle)
    return c * x - s * y, s * x + c * y


def _rays(calibration: Calibration, rotation: FloatArray, du: float, dv: float) -> tuple[FloatArray, FloatArray]:
    """Return unit directions (N, 3) and the length of each ray per unit depth, for all pixels moved by (du, dv)."""
    u = (np.arange(calibration.width_px) + du - calibration.cx_px) / calibration.focal_px
    v = (np.arange(calibration.height_px) + dv - calibration.cy_px) / calibration.focal_px
    length = np.sqrt(u[None, :] ** 2 + v[:, None] ** 2 + 1)
    across, down = u[:, None] * rotation[:, 0] + rotation[:, 2], v[:, None] * rotation[:, 1]
    directions = (across[None] + down[:, None]) / length[..., None]
    return directions.reshape(-1, 3), length.ravel()


def _image(
    field: Heightfield,
    calibration: Calibration,
    rotation: FloatArray,
    eye: FloatArray,
    distance: FloatArray,
    params: TerrainParams,
) -> NDArray[np.uint8]:
    """Render one camera at `eye` (heading frame): the mean of the colours of all rays of a pixel.

    `distance` (N,) is that along the centre rays: the rays of a pixel start just before the nearest of 3 x 3 of them.
    """
    n = params.supersample
    shape = calibration.height_px, calibration.width_px
    capped = np.minimum(distance, 1e6).reshape(shape)
    nearest = cv2.erode(capped, np.ones((3, 3), np.uint8)).ravel()
    start = np.maximum(np.minimum(0.97 * nearest - 0.05, LIMIT_M), 0.0)
    total = np.zeros((shape[0] * shape[1], 3))
    for k in range(n * n):
        directions, _ = _rays(calibration, rotation, (k % n + 0.5) / n - 0.5, (k // n + 0.5) / n - 0.5)
        total += _radiance(field, eye, directions, start, params)
    encoded = 255.0 * np.clip(total / (n * n), 0, 1) ** (1 / DISPLAY_GAMMA)
    return np.rint(encoded).astype(np.uint8).reshape(*shape, 3)


def _radiance(
    field: Heightfield, eye: FloatArray, directions: FloatArray, start: FloatArray, params: TerrainParams
) -> FloatArray:
    """Return linear RGB (N, 3) along rays."""
    distance = field.cast(eye, directions, start)
    upward = np.clip(directions[:, 2] / 0.6, 0, 1)[:, None]
    colour = SKY_LOW + (SKY_HIGH - SKY_LOW) * upward
    hit = np.isfinite(distance)
    t = distance[hit]
    down = np.maximum(-directions[hit, 2], 0.02)
    # A ray covers t / f across and t / (f sin) along the ground; their geometric mean bounds what it can resolve.
    footprint = t / (params.focal_px * params.supersample) / np.sqrt(down)
    points = eye + directions[hit] * t[:, None]
    light, rock, noise = field.surface(points, footprint)
    albedo = SOIL + (ROCK - SOIL) * np.minimum(rock, 1.0)[:, None]
    albedo = albedo * np.exp(params.texture * noise)[:, None]
    haze = 1 - np.exp(-t / HAZE_M)[:, None]
    colour[hit] = (1 - haze) * albedo * light[:, None] * 1.15 + haze * SKY_LOW
    return np.asarray(colour, np.float64)
