"""Elevation grids: GeoTIFF and pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.formats.errors import FormatError
from modules.formats.images import write_image
from modules.types import ElevationMap, FloatImage

NODATA = -9999.0
TAG_PIXEL_SCALE, TAG_TIEPOINT, TAG_GEO_KEYS, TAG_NODATA = 33550, 33922, 34735, 42113
# GeoKeyDirectory: version 1.1.0, two keys: user-defined model type, pixel is area
GEO_KEYS = (1, 1, 0, 2, 1024, 0, 1, 32767, 1025, 0, 1, 1)
VERTICAL_STRETCH = 1.5
SUN = (0.5, 0.5, 0.70710678)  # unit vector to the sun: ahead, left and up, which is the upper left of the picture
PICTURE_SIDE_PX = 900


def write_geotiff(path: Path | str, grid: ElevationMap, layer: str = "elevation") -> None:
    """Write one layer as a float32 GeoTIFF in the local metric frame.

    The first row of the file is the highest y, as north-up readers expect: y runs up, x to the right; nodata is -9999.

    Raises
    ------
    FormatError
        When the layer does not exist or the path cannot be written.
    """
    import tifffile

    path = Path(path)
    if layer not in grid.layers:
        raise FormatError(f"{path}: there is no layer '{layer}'; possible are {', '.join(sorted(grid.layers))}")
    values = np.asarray(grid.layers[layer], np.float32)[::-1]
    values = np.where(np.isfinite(values), values, np.float32(NODATA))
    top = grid.y0_m + grid.shape[0] * grid.cell_m
    nodata = f"{NODATA:g}"
    tags = [
        (TAG_PIXEL_SCALE, "d", 3, (grid.cell_m, grid.cell_m, 0.0), True),
        (TAG_TIEPOINT, "d", 6, (0.0, 0.0, 0.0, grid.x0_m, top, 0.0), True),
        (TAG_GEO_KEYS, "H", len(GEO_KEYS), GEO_KEYS, True),
        (TAG_NODATA, "s", 0, nodata, True),
    ]
    try:
        tifffile.imwrite(path, values, photometric="minisblack", extratags=tags, metadata=None, software="terrex")
    except OSError as error:
        raise FormatError(
            f"{path} cannot be written ({error.strerror}); check the folder and its permissions"
        ) from error


def read_geotiff(path: Path | str) -> ElevationMap:
    """Read a GeoTIFF that `write_geotiff` wrote; the layer is called `elevation` whatever it was.

    Raises
    ------
    FormatError
        When the file is missing, no TIFF or without the geographic tags.
    """
    import tifffile

    path = Path(path)
    if not path.is_file():
        raise FormatError(f"{path} does not exist; check the path of the GeoTIFF")
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            values = np.asarray(page.asarray(), np.float32)
            tags = {code: page.tags[code].value for code in (TAG_PIXEL_SCALE, TAG_TIEPOINT) if code in page.tags}
    except (tifffile.TiffFileError, OSError, ValueError) as error:
        raise FormatError(f"{path} is not a TIFF that can be read ({error}); copy it again") from error
    if len(tags) != 2 or values.ndim != 2:
        raise FormatError(f"{path} has no pixel scale and tie point or several channels; give an elevation GeoTIFF")
    cell, x0, top = float(tags[TAG_PIXEL_SCALE][0]), float(tags[TAG_TIEPOINT][3]), float(tags[TAG_TIEPOINT][4])
    values = np.where(values == NODATA, np.float32(np.nan), values)[::-1].copy()
    return ElevationMap(x0, top - values.shape[0] * cell, cell, {"elevation": values})


def write_hillshade_png(path: Path | str, grid: ElevationMap, contour_m: float | None = None) -> None:
    """Write a shaded relief coloured by height, forward (x) up and left (y) left, unknown cells dark.

    Parameters
    ----------
    path : Path or str
    grid : ElevationMap
    contour_m : float, optional
        Height between contour lines, m; chosen from the relief when None.
    """
    elevation = np.asarray(grid.layers["elevation"], np.float32)
    known = np.isfinite(elevation)
    if not known.any():
        raise FormatError(f"{path}: no cell of the elevation grid is known, so there is nothing to draw")
    low, high = (float(value) for value in np.percentile(elevation[known], [2.0, 98.0]))
    height = np.where(known, elevation, low).astype(np.float32)
    tone = np.clip((height - low) / max(high - low, 1e-3), 0.0, 1.0)
    colours = cv2.applyColorMap(np.rint(tone * 255).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[:, :, ::-1]
    step = contour_m if contour_m is not None else _round_step(max(high - low, 0.01) / 8.0)
    picture = colours * (0.35 + 0.65 * _shade(height, grid.cell_m))[..., None]
    picture = np.where(_contours(height, known, step)[..., None], picture * 0.55, picture)
    picture = np.where(known[..., None], picture, 40.0)
    filled = grid.layers.get("filled")
    if filled is not None:
        picture = np.where(np.asarray(filled, bool)[..., None], picture * 0.6 + 255 * 0.2, picture)
    # Rows are y and columns x: turned, so that forward is up and left is left.
    upright = np.ascontiguousarray(picture.transpose(1, 0, 2)[::-1, ::-1]).clip(0, 255).astype(np.uint8)
    enlarge = max(1, PICTURE_SIDE_PX // max(upright.shape[:2]))
    upright = np.repeat(np.repeat(upright, enlarge, axis=0), enlarge, axis=1)
    write_image(path, _with_legend(upright, enlarge / grid.cell_m, low, high, step))


def _shade(height: FloatImage, cell_m: float) -> FloatImage:
    """Return the cosine between the surface and the sun, (H, W), 0-1."""
    smooth = cv2.GaussianBlur(height, (0, 0), 0.7)
    gy, gx = np.gradient(smooth * VERTICAL_STRETCH, cell_m) if min(height.shape) > 1 else np.zeros((2, *height.shape))
    dot = (-gx * SUN[0] - gy * SUN[1] + SUN[2]) / np.sqrt(gx**2 + gy**2 + 1.0)
    return np.clip(dot, 0.0, 1.0).astype(np.float32)


def _contours(height: FloatImage, known: NDArray[np.bool_], step_m: float) -> NDArray[np.bool_]:
    """Return the cells where the smoothed height passes a multiple of the step."""
    band = np.floor(cv2.GaussianBlur(height, (0, 0), 1.5) / step_m)
    edge = np.zeros(height.shape, bool)
    edge[1:] |= (band[1:] != band[:-1]) & known[1:] & known[:-1]
    edge[:, 1:] |= (band[:, 1:] != band[:, :-1]) & known[:, 1:] & known[:, :-1]
    return edge


def _round_step(value: float) -> float:
    """Return the nearest of 1, 2, 5 times a power of ten that is not smaller."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= value * 0.999))


def _with_legend(
    picture: NDArray[np.uint8], px_per_m: float, low: float, high: float, step: float
) -> NDArray[np.uint8]:
    """Append a strip with a scale bar and the range of heights."""
    width = max(picture.shape[1], 420)
    canvas = np.full((picture.shape[0] + 44, width, 3), 255, np.uint8)
    canvas[: picture.shape[0], : picture.shape[1]] = picture
    bar_m = _round_step(width / px_per_m / 8.0)
    y = picture.shape[0] + 16
    cv2.rectangle(canvas, (10, y - 4), (10 + round(bar_m * px_per_m), y), (0, 0, 0), -1)
    text = f"{bar_m:g} m   heights {low:.2f} to {high:.2f} m   contours {step:g} m"
    cv2.putText(canvas, text, (10, y + 20), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return canvas
