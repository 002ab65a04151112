"""Options about terrain products, which several commands share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from expert.cli.usage import UsageError

if TYPE_CHECKING:
    from expert.pair import StereoPair
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


def masked(pair: StereoPair, path: Path | None) -> StereoPair:
    """Return the pair with the black pixels of a mask taken out of its left image."""
    import numpy as np

    from modules.formats.images import read_image

    if path is None:
        return pair
    image = read_image(path)
    if image.shape[:2] != pair.left.shape[:2]:
        raise UsageError(
            f"{path} is {image.shape[1]}x{image.shape[0]} and the left image is "
            f"{pair.left.shape[1]}x{pair.left.shape[0]}; make the mask on the rectified left image"
        )
    usable = np.asarray(image > 0 if image.ndim == 2 else (image > 0).any(axis=2), bool)
    if not usable.any():
        raise UsageError(f"{path} is black everywhere, so no pixel is left; paint white what may be used")
    return replace(pair, left_mask=usable if pair.left_mask is None else usable & pair.left_mask)


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
