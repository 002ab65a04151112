"""Elevation grids: GeoTIFF."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modules.formats._text import unwritable
from modules.formats.errors import FormatError
from modules.types import Datum, ElevationMap, FloatImage

NODATA = -9999.0
TAG_PIXEL_SCALE, TAG_TIEPOINT, TAG_GEO_KEYS, TAG_NODATA = 33550, 33922, 34735, 42113
# GeoKeyDirectory: version 1.1.0, two keys: user-defined model type, pixel is area
GEO_KEYS = (1, 1, 0, 2, 1024, 0, 1, 32767, 1025, 0, 1, 1)


def write_geotiff(path: Path | str, grid: ElevationMap, layer: str = "elevation", datum: Datum | None = None) -> None:
    """Write one layer as a float32 GeoTIFF.

    The first row of the file is the highest y, as north-up readers expect: y runs up, x to the right; nodata is -9999.
    Without a datum the file is in the local metric frame and has no coordinate reference system. With one, x is east
    and y is north of it, and the system is a transverse Mercator projection about the datum, which agrees with the
    tangent plane to 1 mm within 6 km.

    Raises
    ------
    FormatError
        When the layer does not exist, the path cannot be written, or there is a datum and rasterio is not installed.
    """
    path = Path(path)
    if layer not in grid.layers:
        raise FormatError(f"{path}: there is no layer '{layer}'; possible are {', '.join(sorted(grid.layers))}")
    values = np.asarray(grid.layers[layer], np.float32)[::-1]
    values = np.where(np.isfinite(values), values, np.float32(NODATA)).astype(np.float32)
    top = grid.y0_m + grid.shape[0] * grid.cell_m
    try:
        if datum is None:
            _write_local(path, values, grid, top)
        else:
            _write_located(path, values, grid, top, datum)
    except OSError as error:
        raise unwritable(path, error) from error


def _write_local(path: Path, values: FloatImage, grid: ElevationMap, top: float) -> None:
    import tifffile

    tags = [
        (TAG_PIXEL_SCALE, "d", 3, (grid.cell_m, grid.cell_m, 0.0), True),
        (TAG_TIEPOINT, "d", 6, (0.0, 0.0, 0.0, grid.x0_m, top, 0.0), True),
        (TAG_GEO_KEYS, "H", len(GEO_KEYS), GEO_KEYS, True),
        (TAG_NODATA, "s", 0, f"{NODATA:g}", True),
    ]
    tifffile.imwrite(path, values, photometric="minisblack", extratags=tags, metadata=None, software="terrex")


def _write_located(path: Path, values: FloatImage, grid: ElevationMap, top: float, datum: Datum) -> None:
    try:
        import rasterio
        from rasterio.crs import CRS
    except ImportError as error:
        raise FormatError(
            f"{path}: a coordinate reference system needs rasterio, which is not installed; "
            "install terrex[geo] or leave the datum out"
        ) from error
    crs = CRS.from_proj4(
        f"+proj=tmerc +lat_0={datum.latitude_deg:.10f} +lon_0={datum.longitude_deg:.10f} +k=1 +x_0=0 +y_0=0 "
        "+datum=WGS84 +units=m +no_defs"
    )
    transform = rasterio.Affine(grid.cell_m, 0.0, grid.x0_m, 0.0, -grid.cell_m, top)
    options = {"width": values.shape[1], "height": values.shape[0], "count": 1, "dtype": "float32", "nodata": NODATA}
    with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=transform, **options) as file:
        file.write(values, 1)


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
