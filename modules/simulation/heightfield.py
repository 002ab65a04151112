"""A synthetic rocky heightfield with its reflectance, and what a camera sees of it.

The field lives in the heading frame: the level frame turned by the yaw of the body, so that the fine grid always lies
in front of the camera. The callers of this file convert.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]
Points = NDArray[np.float64]

NEAR_CELL_M = 0.01
NEAR_X_M = (-1.0, 19.48)  # 2048 cells
NEAR_Y_M = (-10.24, 10.24)
FAR_CELL_M = 0.25
FAR_X_M = (-20.0, 172.0)  # 768 cells
FAR_Y_M = (-128.0, 128.0)
LIMIT_M = 170.0  # terrain ends here
CLEAR_RADIUS_M = 0.6  # no rock stands where the body does
TILE_SIZE = 512
TEXELS_PER_WAVE = 8.0
WAVELENGTHS_M = 0.004 * 2.0 ** np.arange(14)  # 4 mm to 33 m


@dataclass(frozen=True)
class Grid:
    """One height grid: node (i, j) is at (x0_m + j cell_m, y0_m + i cell_m).

    Attributes
    ----------
    height_m, light, rock : float32 (H, W)
        Height; irradiance over that of a surface facing the sun; 0 for soil to 1 for rock.
    maxima_m, coarse_maxima_m : float32
        Largest height of each block of cells, and of each block of blocks.
    """

    x0_m: float
    y0_m: float
    cell_m: float
    height_m: FloatArray
    maxima_m: FloatArray
    coarse_maxima_m: FloatArray
    light: FloatArray
    rock: FloatArray

    @property
    def at(self) -> tuple[float, float, float]:
        """Position and cell size as the kernels want them."""
        return self.x0_m, self.y0_m, self.cell_m


@dataclass(frozen=True)
class Heightfield:
    """A surface z(x, y) in the heading frame, with the noise that textures it."""

    near: Grid
    far: Grid
    tile: FloatArray
    offsets: NDArray[np.float64]

    def height_m(self, x_m: Points, y_m: Points) -> Points:
        """Return the heights in m at points of one shape."""
        from modules.simulation import _raycast

        x, y = np.broadcast_arrays(np.asarray(x_m, np.float64), np.asarray(y_m, np.float64))
        flat = _raycast.heights(
            self.near.height_m, self.near.at, self.far.height_m, self.far.at, x.ravel().copy(), y.ravel().copy()
        )
        return np.asarray(flat).reshape(x.shape)

    def cast(self, origin: Points, directions: Points, start_m: Points | None = None) -> Points:
        """Return the distance in m along each unit direction (N, 3) to the surface, inf where it is missed.

        `start_m` (N,), if given, are distances at which the rays are known to be still above the surface.
        """
        from modules.simulation import _raycast

        top = float(max(self.near.maxima_m.max(), self.far.maxima_m.max()))
        near, far = self.near, self.far
        return np.asarray(
            _raycast.cast(
                np.ascontiguousarray(origin, np.float64),
                np.ascontiguousarray(directions, np.float64),
                np.zeros(len(directions)) if start_m is None else start_m,
                near.height_m,
                near.at,
                near.maxima_m,
                near.coarse_maxima_m,
                far.height_m,
                far.at,
                far.maxima_m,
                far.coarse_maxima_m,
                top,
                LIMIT_M,
            )
        )

    def sees(self, origin: Points, points: Points) -> NDArray[np.bool_]:
        """Return whether nothing stands between the origin and each surface point (N, 3)."""
        offset = points - origin
        distance = np.linalg.norm(offset, axis=1)
        hit = self.cast(origin, offset / distance[:, None])
        # One cell of the grid: a ray that grazes the point itself is not blocked by it.
        return np.asarray(hit >= distance - NEAR_CELL_M - 1e-3 * distance)

    def surface(self, points: Points, footprint_m: Points) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return light, rock and texture (unit variance per octave) at surface points (N, 3)."""
        from modules.simulation import _raycast

        x, y = points[:, 0], points[:, 1]
        inside = (x >= NEAR_X_M[0]) & (x < NEAR_X_M[1]) & (y >= NEAR_Y_M[0]) & (y < NEAR_Y_M[1])
        light = np.where(inside, _lookup(self.near.light, self.near, x, y), _lookup(self.far.light, self.far, x, y))
        rock = np.where(inside, _lookup(self.near.rock, self.near, x, y), _lookup(self.far.rock, self.far, x, y))
        noise = _raycast.texture(self.tile, points, footprint_m, WAVELENGTHS_M, self.offsets, TEXELS_PER_WAVE)
        return light, rock, noise


def _lookup(layer: FloatArray, grid: Grid, x_m: Points, y_m: Points) -> FloatArray:
    from modules.simulation import _raycast

    return np.asarray(_raycast.heights(layer, grid.at, layer, grid.at, x_m.copy(), y_m.copy()), np.float32)


def fractal(
    rng: np.random.Generator, shape: tuple[int, int], cell_m: float, band_m: tuple[float, float], exponent: float
) -> FloatArray:
    """Draw periodic Gaussian noise with power ~ frequency^-exponent between two wavelengths, of unit variance.

    References
    ----------
    R. F. Voss, Random fractal forgeries, in: Fundamental Algorithms for Computer Graphics, 1985.
    """
    from scipy import fft

    white = rng.standard_normal(shape, dtype=np.float32)
    fy = np.fft.fftfreq(shape[0], cell_m).astype(np.float32)[:, None]
    fx = np.fft.rfftfreq(shape[1], cell_m).astype(np.float32)[None, :]
    frequency = np.hypot(fx, fy)
    frequency[0, 0] = np.inf
    gain = frequency ** np.float32(-exponent / 2)
    shortest, longest = np.float32(band_m[0]), np.float32(band_m[1])
    gain *= np.exp(-((frequency * shortest) ** 2)) * (1 - np.exp(-((frequency * longest) ** 2)))
    gain[0, 0] = 0.0
    frequency[0, 0] = 0.0
    noise = fft.irfft2(fft.rfft2(white) * np.nan_to_num(gain), s=shape)
    return np.asarray(noise / noise.std(), np.float32)


def _axes(x_m: tuple[float, float], y_m: tuple[float, float], cell_m: float) -> tuple[Points, Points]:
    columns = round((x_m[1] - x_m[0]) / cell_m) + 1
    rows = round((y_m[1] - y_m[0]) / cell_m) + 1
    x: Points = x_m[0] + cell_m * np.arange(columns, dtype=np.float64)
    y: Points = y_m[0] + cell_m * np.arange(rows, dtype=np.float64)
    return x, y


def _draw_rocks(
    rng: np.random.Generator, area_m2: float, abundance: float, smallest_m: float, largest_m: float
) -> Points:
    """Draw rock diameters from the exponential area model of Golombek & Rapp.

    References
    ----------
    M. Golombek and D. Rapp, Size-frequency distributions of rocks on Mars and Earth analog sites, Journal of
    Geophysical Research 102, 1997.
    """
    edges = np.geomspace(smallest_m, largest_m, 60)
    rate = 1.79 + 0.152 / abundance
    covered = abundance * (np.exp(-rate * edges[:-1]) - np.exp(-rate * edges[1:])) * area_m2
    middle = np.sqrt(edges[:-1] * edges[1:])
    counts = rng.poisson(covered / (np.pi / 4 * middle**2))
    return np.repeat(middle, counts)[::-1]


def _place_rocks(
    rng: np.random.Generator, diameters: Points, height: FloatArray, rock: FloatArray, x: Points, y: Points
) -> None:
    """Raise angular rocks, convex polyhedra half sunk in the ground, in place."""
    cell = x[1] - x[0]
    for diameter in diameters:
        cx, cy = rng.uniform(x[0], x[-1]), rng.uniform(y[0], y[-1])
        faces = 9
        azimuth = (np.arange(faces) + rng.uniform(-0.4, 0.4, faces)) * (2 * np.pi / faces)
        slope = rng.uniform(1.0, 4.0, faces)
        radius = diameter / 2 * rng.uniform(0.7, 1.1, faces)
        peak = diameter * rng.uniform(0.3, 0.65)
        tilt = rng.uniform(-0.3, 0.3, 2)
        stretch = rng.uniform(0.7, 1.0)
        grey = rng.uniform(0.55, 1.0)
        if np.hypot(cx, cy) < CLEAR_RADIUS_M + diameter:
            continue
        reach = int(np.ceil(0.75 * diameter / cell)) + 1
        j, i = round((cx - x[0]) / cell), round((cy - y[0]) / cell)
        rows = slice(max(i - reach, 0), min(i + reach + 1, len(y)))
        columns = slice(max(j - reach, 0), min(j + reach + 1, len(x)))
        dx = (x[columns] - cx)[None, :]
        dy = (y[rows] - cy)[:, None] / stretch
        body = peak + tilt[0] * dx + tilt[1] * dy
        for a, s, r in zip(azimuth, slope, radius, strict=True):
            body = np.minimum(body, s * (r - np.cos(a) * dx - np.sin(a) * dy))
        patch = height[rows, columns]
        base = patch[min(i - rows.start, patch.shape[0] - 1), min(j - columns.start, patch.shape[1] - 1)]
        raised = (base - 0.12 * diameter + body).astype(np.float32)
        above = (raised > patch) & (body > 0)
        patch[above] = raised[above]
        rock[rows, columns][above] = grey


def _taper(x: Points, y: Points, width_m: float) -> FloatArray:
    """Return 1 inside, falling smoothly to 0 at the border over `width_m`."""

    def ramp(v: Points) -> Points:
        edge: Points = np.clip(np.minimum(v - v[0], v[-1] - v) / width_m, 0, 1)
        return edge * edge * (3 - 2 * edge)

    return (ramp(y)[:, None] * ramp(x)[None, :]).astype(np.float32)


def _grid(height: FloatArray, rock: FloatArray, x: Points, y: Points, sun: tuple[float, float], ambient: float) -> Grid:
    """Light a height grid: Lambert's law times the visibility of the sun, plus ambient light."""
    from modules.simulation import _raycast

    cell = float(x[1] - x[0])
    azimuth, elevation = sun
    direct = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    gy, gx = np.gradient(height, cell)
    norm = np.sqrt(1 + gx * gx + gy * gy)
    lambert = np.maximum(direct[2] - gx * direct[0] - gy * direct[1], 0) / norm
    maxima, coarse = _raycast.block_maxima(height)
    lit = np.asarray(_raycast.sunlit(height, maxima, cell, np.cos(azimuth), np.sin(azimuth), float(np.tan(elevation))))
    light = (1 - ambient) * lambert * lit + ambient * 0.5 * (1 + 1 / norm)
    return Grid(float(x[0]), float(y[0]), cell, height, maxima, coarse, light.astype(np.float32), rock)


def build_heightfield(
    seed: int,
    roughness_m: float,
    relief_m: float,
    hills_m: float,
    rock_abundance: float,
    rock_diameter_m: tuple[float, float],
    sun_azimuth_rad: float,
    sun_elevation_rad: float,
    ambient: float,
) -> Heightfield:
    """Draw a heightfield: fractal ground on a wavy plain with hills at its end, and rocks; z(0, 0) = 0.

    Parameters
    ----------
    seed : int
        Seed of the generator; equal arguments give equal bits.
    roughness_m, relief_m : float
        Standard deviation of the ground at wavelengths below 2 m and of 4 to 40 m.
    hills_m : float
        Height scale of the hills beyond 40 m.
    rock_abundance : float
        Fraction of the area covered by rocks of any size; 0 for none.
    rock_diameter_m : (float, float)
        Smallest and largest rock.
    sun_azimuth_rad, sun_elevation_rad : float
        Direction to the sun; azimuth 0 is straight ahead, positive to the left.
    ambient : float
        Fraction of the light that comes from the sky.
    """
    ground_rng, far_rng, rock_rng, tile_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
    fx, fy = _axes(FAR_X_M, FAR_Y_M, FAR_CELL_M)
    nx, ny = _axes(NEAR_X_M, NEAR_Y_M, NEAR_CELL_M)

    shape = (len(fy), len(fx))
    distance = np.hypot(fx[None, :], fy[:, None])
    rise = np.clip((distance - 40.0) / 110.0, 0, 1) ** 1.5
    far = relief_m * fractal(far_rng, shape, FAR_CELL_M, (4.0, 40.0), 3.0)
    hills = fractal(far_rng, shape, FAR_CELL_M, (6.0, 120.0), 3.6)
    far = (far + hills_m * rise * (0.7 + 0.6 * hills)).astype(np.float32)
    columns, rows = (np.flatnonzero((v > n[0] - 0.5) & (v < n[-1] + 0.5)) for v, n in ((fx, nx), (fy, ny)))
    rough = np.ones(shape, np.float32)
    rough[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] = 0  # the near grid brings its own
    far += 2 * roughness_m * rough * fractal(far_rng, shape, FAR_CELL_M, (0.7, 4.0), 2.6)
    far_rock = np.zeros_like(far)

    if rock_abundance > 0:
        # Boulders of the plain behind the near grid; the near grid has its own.
        plain = far.copy()
        area = float(np.ptp(fx) * np.ptp(fy))
        boulders = _draw_rocks(far_rng, area, rock_abundance, 0.8, 2.5)
        _place_rocks(far_rng, boulders, far, far_rock, fx, fy)
        margin = 3.0
        keep = ((fx > nx[0] - margin) & (fx < nx[-1] + margin))[None, :] & (
            (fy > ny[0] - margin) & (fy < ny[-1] + margin)
        )[:, None]
        far[keep] = plain[keep]
        far_rock[keep] = 0
    near = _upsample(far, fx, fy, nx, ny)
    taper = _taper(nx, ny, 1.0)
    detail = fractal(ground_rng, (2160, 2160), NEAR_CELL_M, (0.02, 2.0), 3.4)[: len(ny), : len(nx)]
    near = (near + roughness_m * taper * detail).astype(np.float32)
    near_rock = np.zeros_like(near)
    if rock_abundance > 0:
        smallest, largest = rock_diameter_m
        area = float((np.ptp(nx) - 2) * (np.ptp(ny) - 2))
        diameters = _draw_rocks(rock_rng, area, rock_abundance, smallest, largest)
        margin_cells = 100  # the metre of the taper: rocks never touch the seam
        inner = (slice(margin_cells, -margin_cells), slice(margin_cells, -margin_cells))
        _place_rocks(rock_rng, diameters, near[inner], near_rock[inner], nx[inner[1]], ny[inner[0]])

    origin = near[round(-ny[0] / NEAR_CELL_M), round(-nx[0] / NEAR_CELL_M)]
    sun = (sun_azimuth_rad, sun_elevation_rad)
    soft = np.asarray(cv2.GaussianBlur(near_rock, (0, 0), 0.7), np.float32)
    tile = fractal(tile_rng, (TILE_SIZE, TILE_SIZE), 1.0 / TEXELS_PER_WAVE, (0.5, 1.5), 1.0)
    return Heightfield(
        _grid(near - origin, soft, nx, ny, sun, ambient),
        _grid(far - origin, far_rock, fx, fy, sun, ambient),
        tile,
        tile_rng.uniform(0, TILE_SIZE, (len(WAVELENGTHS_M), 2)),
    )


def _upsample(far: FloatArray, fx: Points, fy: Points, nx: Points, ny: Points) -> FloatArray:
    """Interpolate the far grid at the near nodes: smoothly inside, bilinearly at the border, where the grids meet."""
    from scipy.interpolate import RectBivariateSpline

    columns = (fx > nx[0] - 2) & (fx < nx[-1] + 2)
    rows = (fy > ny[0] - 2) & (fy < ny[-1] + 2)
    x, y, crop = fx[columns], fy[rows], far[np.ix_(rows, columns)]
    smooth = RectBivariateSpline(y, x, crop)(ny, nx)
    linear = RectBivariateSpline(y, x, crop, kx=1, ky=1)(ny, nx)
    taper = _taper(nx, ny, 1.0)
    return np.asarray(taper * smooth + (1 - taper) * linear, np.float32)
