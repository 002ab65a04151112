"""`terrex fuse`: one map of several pairs with poses."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from expert.cli.terrain_options import DatumOption, ProductsOption, RoverOption, stated_datum, stated_rover
from expert.cli.usage import UsageError


def fuse(
    folders: Annotated[list[Path], typer.Argument(help="Folders with left.png, right.png and calibration.yaml")],
    poses: Annotated[
        Path, typer.Option(help="CSV: name,time_s,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg[,sigma_m,sigma_deg]")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the map; appears whole or not at all")],
    calibration: Annotated[Path | None, typer.Option(help="One calibration for all pairs")] = None,
    cell: Annotated[float, typer.Option(help="Cell of the map, m")] = 0.05,
    rules: Annotated[list[Path] | None, typer.Option(help="Rule file layered on the shipped rules")] = None,
    products: ProductsOption = None,
    rover: RoverOption = None,
    datum: DatumOption = None,
) -> None:
    """Fuse the terrain of several pairs, named in the pose file by their folders, into one map."""
    from expert.api import ExpertSystem
    from expert.pair import StereoPair
    from expert.products import DEFAULT_PRODUCTS, check_products
    from expert.sequence import View
    from expert.sequence import fuse as fuse_views
    from modules.formats.atomic import check_folder
    from modules.formats.poses import read_poses
    from modules.operator import OperatorError

    check_folder(out)
    if not 0.001 <= cell <= 100.0:
        raise UsageError(f"--cell {cell:g} is outside 0.001 to 100 m")
    names = DEFAULT_PRODUCTS if products is None else tuple(name.strip() for name in products.split(","))
    chosen, place = check_products((*names, "layers.npz")), stated_datum(datum)
    by_name = {folder.resolve().name: folder for folder in folders}
    if len(by_name) < len(folders):
        raise UsageError(
            "two folders have one name, by which the pose file would mean both "
            f"({', '.join(map(str, folders))}); rename one of them"
        )
    stamped = read_poses(poses)
    lacking = sorted(set(by_name) - {item.name for item in stamped})
    if lacking:
        raise UsageError(f"{poses} has no pose for {', '.join(lacking)}; add a line for each folder")
    system = ExpertSystem(rules=rules or [], rover=stated_rover(rover))

    def views() -> Iterator[View]:
        for item in stamped:
            if item.name in by_name:
                folder = by_name[item.name]
                camera = calibration or folder / "calibration.yaml"
                pair = StereoPair.load(folder / "left.png", folder / "right.png", calibration=camera)
                yield View(pair, item.pose, item.time_s)

    try:
        result = fuse_views(system, views(), cell_m=cell)
    except OperatorError as error:
        raise UsageError(str(error)) from error
    result.save(out, products=chosen, datum=place)
    layers = result.elevation.layers
    moving = int(layers["moving"].astype(bool).sum())
    typer.echo(
        f"{len(result.decisions) - len(result.skipped)} of {len(result.decisions)} views fused into "
        f"{int((layers['views'].astype(int) > 0).sum())} cells of {cell:g} m, {moving} of them inconsistent"
    )
    for reason in result.skipped:
        typer.echo(f"skipped {reason}")
    typer.echo(f"written to {out}")
    if result.skipped:
        raise typer.Exit(1)
