"""Time every writer of terrain products, beside the writer of a well-known library: `make bench-writers`.

    python -m benchmarks.writers [--points 300000] [--cells 400]

Printed are the least CPU time of five runs, the size of the file, and both for the library where there is one (plyfile,
laspy, trimesh, rasterio, Pillow, NumPy's `savez_compressed`), which gets arrays of the same content: the mesh is ready
for trimesh, ours makes it of the map, and Pillow gets an empty picture that ours draws. Our LAS is laspy's too.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import plyfile
import rasterio
import trimesh
from PIL import Image

from benchmarks.terrain_speed import cpu_ms
from modules import formats
from modules.formats.viewer import write_viewer
from modules.primitives.surface import surface_of
from modules.types import ElevationMap, PointCloud

Job = Callable[[Path], object]


def cloud(count: int) -> PointCloud:
    """Return points (N,) with colours, without covariance, which the libraries' plain writers would not take."""
    rng = np.random.default_rng(1)
    xyz = np.column_stack([rng.uniform(0, 9, count), rng.uniform(-5, 5, count), rng.normal(0, 0.05, count)])
    rgb = rng.integers(0, 256, (count, 3), dtype=np.uint8)
    return PointCloud(xyz.astype(np.float32), "level", np.arange(count, dtype=np.int32), rgb)


def terrain(cells: int) -> ElevationMap:
    """Return a map of rolling ground with the layers that a reconstruction makes."""
    i, j = np.indices((cells, cells))
    z = (0.3 * np.sin(i / 17.0) * np.cos(j / 23.0) + np.random.default_rng(2).normal(0, 0.01, i.shape)).astype(
        np.float32
    )
    z[(i // 40 + j // 40) % 7 == 0] = np.nan
    smooth = {
        name: np.where(np.isnan(z), np.nan, 0.1 * z + 0.5).astype(np.float32) for name in ("slope_deg", "sigma_m")
    }
    counted = {"count": np.full(z.shape, 7, np.int32), "filled": np.zeros(z.shape, np.uint8)}
    driven = {"traversability": smooth["sigma_m"], "hazard": np.where(np.isnan(z), 255, 0).astype(np.uint8)}
    return ElevationMap(0.0, -0.025 * cells, 0.05, {"elevation": z, **smooth, **counted, **driven})


def jobs(points: PointCloud, grid: ElevationMap) -> dict[str, tuple[Job, Job | None]]:
    """Return by file name our writer and the library's."""
    surface = surface_of(grid)
    records = np.empty(
        len(points), [(name, "<f4") for name in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")]
    )
    for axis, name in enumerate("xyz"):
        records[name] = points.xyz_m[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        records[name] = np.asarray(points.rgb)[:, channel]

    def by_laspy(path: Path) -> None:
        header = laspy.LasHeader(point_format=7, version="1.4")
        header.scales = np.full(3, 0.001)
        las = laspy.LasData(header)
        las.x, las.y, las.z = points.xyz_m.T
        las.red, las.green, las.blue = (np.asarray(points.rgb).T.astype(np.uint16) * 257).astype(np.uint16)
        las.write(path)

    def by_rasterio(path: Path) -> None:
        z = np.asarray(grid.layers["elevation"])
        with rasterio.open(path, "w", "GTiff", z.shape[1], z.shape[0], 1, dtype="float32", compress="deflate") as file:
            file.write(z, 1)

    def by_trimesh(path: Path) -> None:
        trimesh.Trimesh(surface.vertices_m, surface.faces, vertex_colors=surface.rgb, process=False).export(path)

    relief = np.zeros((*grid.shape, 3), np.uint8)
    return {
        "points.ply": (
            lambda path: formats.write_ply(path, points),
            lambda path: plyfile.PlyData([plyfile.PlyElement.describe(records, "vertex")]).write(path),
        ),
        "points.pcd": (lambda path: formats.write_pcd(path, points), None),
        "points.las": (lambda path: formats.write_las(path, points), by_laspy),
        "points.laz": (lambda path: formats.write_las(path, points), by_laspy),
        "elevation.tif": (lambda path: formats.write_geotiff(path, grid), by_rasterio),
        "mesh.obj": (lambda path: formats.write_obj(path, grid), by_trimesh),
        "mesh.glb": (lambda path: formats.write_glb(path, grid), by_trimesh),
        "layers.npz": (
            lambda path: formats.write_layers(path, grid),
            lambda path: np.savez_compressed(path, **dict(grid.layers)),  # type: ignore[arg-type]
        ),
        "grid_map.npz": (lambda path: formats.write_grid_map(path, grid), None),
        "occupancy.yaml": (lambda path: formats.write_occupancy(path, grid), None),
        "height.png": (
            lambda path: formats.write_terrain_picture(path, grid, "height"),
            lambda path: Image.fromarray(relief).save(path),
        ),
        "terrain.html": (lambda path: write_viewer(path, grid, points), None),
    }


def measured(job: Job, path: Path) -> tuple[float, float]:
    """Return the CPU time in ms and the size in MB."""
    spent = cpu_ms(lambda: job(path))
    return spent, path.stat().st_size / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=300_000)
    parser.add_argument("--cells", type=int, default=400, help="edge of the map")
    args = parser.parse_args()
    warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
    print(f"{args.points} points, {args.cells}x{args.cells} cells   ms      MB   library ms      MB")
    with tempfile.TemporaryDirectory() as folder:
        for name, (ours, theirs) in jobs(cloud(args.points), terrain(args.cells)).items():
            line = "{:30s} {:8.1f} {:7.2f}".format(name, *measured(ours, Path(folder, name)))
            if theirs is not None:
                line += " {:12.1f} {:7.2f}".format(*measured(theirs, Path(folder, f"library_{name}")))
            print(line)


if __name__ == "__main__":
    main()
