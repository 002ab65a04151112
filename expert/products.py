"""The files that a caller may choose among, by name."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

from modules.formats.elevation import write_geotiff
from modules.formats.errors import FormatError
from modules.formats.layers import write_grid_map, write_layers
from modules.formats.mesh import write_glb, write_obj
from modules.formats.occupancy import write_occupancy
from modules.formats.points import write_las, write_pcd, write_ply
from modules.formats.terrain_pictures import write_ortho, write_terrain_picture
from modules.formats.viewer import write_viewer
from modules.primitives.surface import cell_colours
from modules.types import Datum, ElevationMap, PointCloud


@dataclass(frozen=True)
class Terrain:
    """What products are made of."""

    elevation: ElevationMap | None
    points: PointCloud | None = None
    datum: Datum | None = None
    name: str = "terrain"

    @property
    def grid(self) -> ElevationMap:
        """The elevation map.

        Raises
        ------
        FormatError
            There is none.
        """
        if self.elevation is None:
            raise FormatError("there is no elevation map; the gates or the grid dropped everything")
        return self.elevation

    def gives(self, product: Product) -> bool:
        """Return whether this product can be made of what there is."""
        if product.of_points:
            return self.points is not None
        if product.coloured and (self.points is None or self.points.rgb is None):
            return False
        return self.elevation is not None and product.layer in self.elevation.layers


@dataclass(frozen=True)
class Product:
    """One file.

    Attributes
    ----------
    summary : str
        What it is, for the help.
    write : callable
        Writes it to a path.
    of_points : bool
        Whether it is made of points; of the elevation map otherwise.
    coloured : bool
        Whether it needs the colours of points beside the elevation map.
    layer : str
        Layer that must be there, and without which the file is left out.
    package : str or None
        Package of an extra that it needs.
    """

    summary: str
    write: Callable[[Path, Terrain], None]
    of_points: bool = False
    coloured: bool = False
    layer: str = "elevation"
    package: str | None = None


def _points(write: Callable[[Path, PointCloud], None]) -> Callable[[Path, Terrain], None]:
    def written(path: Path, terrain: Terrain) -> None:
        if terrain.points is not None:
            write(path, terrain.points)

    return written


def _write_ortho(path: Path, terrain: Terrain) -> None:
    write_ortho(path, terrain.grid, cell_colours(terrain.grid, terrain.points))


PRODUCTS: Mapping[str, Product] = MappingProxyType(
    {
        "points.ply": Product("points with colour and covariance", _points(write_ply), of_points=True),
        "points.pcd": Product("points for the Point Cloud Library", _points(write_pcd), of_points=True),
        "points.las": Product("points for surveyors", _points(write_las), of_points=True, package="laspy"),
        "points.laz": Product("the same, compressed", _points(write_las), of_points=True, package="laspy"),
        "elevation.tif": Product("elevation as GeoTIFF", lambda path, t: write_geotiff(path, t.grid, datum=t.datum)),
        "mesh.obj": Product("mesh with vertex colours", lambda path, t: write_obj(path, t.grid, t.points)),
        "mesh.glb": Product("mesh as binary glTF", lambda path, t: write_glb(path, t.grid, t.points)),
        "layers.npz": Product("all layers, with units", lambda path, t: write_layers(path, t.grid)),
        "grid_map.npz": Product("all layers as grid_map holds them", lambda path, t: write_grid_map(path, t.grid)),
        "occupancy.yaml": Product(
            "hazards for the map_server of ROS 2, with occupancy.pgm",
            lambda path, t: write_occupancy(path, t.grid),
            layer="hazard",
        ),
        "ortho.png": Product("the ground from above, coloured by the image", _write_ortho, coloured=True),
        "elevation.png": Product("shaded relief", lambda path, t: write_terrain_picture(path, t.grid)),
        "height.png": Product("heights", lambda path, t: write_terrain_picture(path, t.grid, "height")),
        "slope.png": Product("slopes", lambda path, t: write_terrain_picture(path, t.grid, "slope"), layer="slope_deg"),
        "traversability.png": Product(
            "where the rover may go",
            lambda path, t: write_terrain_picture(path, t.grid, "traversability"),
            layer="traversability",
        ),
        "coverage.png": Product(
            "what was measured, filled, hidden or missed",
            lambda path, t: write_terrain_picture(path, t.grid, "coverage"),
            layer="sight",
        ),
        "terrain.html": Product("interactive 3D page", lambda path, t: write_viewer(path, t.grid, t.points, t.name)),
    }
)
DEFAULT_PRODUCTS = ("points.ply", "elevation.tif", "layers.npz", "ortho.png", "elevation.png", "traversability.png")


def check_products(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the products asked for, `all` standing for every one whose extra is installed.

    Raises
    ------
    FormatError
        A name is unknown, or the extra that it needs is not installed; all such names are told.
    """
    asked = [name for name in dict.fromkeys(names) if name]
    if "all" in asked:
        asked += [name for name, product in PRODUCTS.items() if _installed(product)]
    chosen = tuple(dict.fromkeys(name for name in asked if name != "all"))
    unknown = [name for name in chosen if name not in PRODUCTS]
    problems = []
    if unknown:
        problems.append(f"there is no product {', '.join(unknown)}; possible are all, {', '.join(PRODUCTS)}")
    problems += [
        f"{name} needs {PRODUCTS[name].package}, which is not installed; install terrex[geo]"
        for name in chosen
        if name in PRODUCTS and not _installed(PRODUCTS[name])
    ]
    if problems:
        raise FormatError("; ".join(problems))
    return chosen


def _installed(product: Product) -> bool:
    return product.package is None or importlib.util.find_spec(product.package) is not None


def product_writers(terrain: Terrain, names: Iterable[str]) -> dict[str, Callable[[Path], None]]:
    """Return what writes each product that this terrain can give."""
    possible = {name: PRODUCTS[name] for name in names if terrain.gives(PRODUCTS[name])}
    return {name: partial(_write, product, terrain) for name, product in possible.items()}


def _write(product: Product, terrain: Terrain, path: Path) -> None:
    product.write(path, terrain)
