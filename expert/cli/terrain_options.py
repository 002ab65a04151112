"""Options about terrain products, which several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from expert.cli.usage import UsageError

if TYPE_CHECKING:
    from modules.types import Datum, Rover

ProductsOption = Annotated[
    str | None,
    typer.Option(
        "--products",
        metavar="NAME,...",
        help="Terrain products, or all: points.ply|pcd|las|laz, elevation.tif, mesh.obj|glb, layers.npz, grid_map.npz, "
        "occupancy.yaml, elevation|height|slope|traversability|coverage|ortho.png, terrain.html",
    ),
]
RoverOption = Annotated[
    Path | None,
    typer.Option(
        "--rover",
        help="YAML with wheel_radius_m, clearance_m, width_m, max_tilt_deg, body_front_m, body_back_m, min_confidence, "
        "min_grazing_deg",
    ),
]
DatumOption = Annotated[
    tuple[float, float] | None,
    typer.Option("--datum", metavar="LAT LON", help="Degrees of the origin, if yaw counts from east; for the GeoTIFF"),
]
MaskOption = Annotated[
    Path | None,
    typer.Option("--mask", help="Image as large as the rectified left one; black where the robot itself is seen"),
]


def stated_products(text: str | None) -> tuple[str, ...]:
    """Return the products asked for, checked before anything is computed."""
    from expert.products import DEFAULT_PRODUCTS, check_products

    return DEFAULT_PRODUCTS if text is None else check_products(name.strip() for name in text.split(","))


def stated_rover(path: Path | None) -> Rover | None:
    """Return the rover of a file."""
    from modules.formats.rover import read_rover

    return None if path is None else read_rover(path)


def stated_datum(place: tuple[float, float] | None) -> Datum | None:
    """Return the datum, or refuse what is no place or cannot be written."""
    import importlib.util

    from modules.types import Datum

    if place is None:
        return None
    if importlib.util.find_spec("rasterio") is None:
        raise UsageError("--datum needs rasterio, which is not installed; install terrex[geo]")
    try:
        return Datum(*place)
    except ValueError as error:
        raise UsageError(str(error)) from error
