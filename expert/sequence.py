"""Several pairs with poses, fused into one map."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from expert.api import ExpertSystem
from expert.decision import Decision
from expert.pair import StereoPair
from expert.plan import NONE, StagePlan
from expert.products import DEFAULT_PRODUCTS, Terrain, check_products, product_writers
from modules.catalog import operators
from modules.formats.atomic import whole_folder
from modules.formats.tiles import TileFolder
from modules.operator import OperatorError
from modules.reconstruction.fuse_views import FusedMap
from modules.types import Datum, Disparity, ElevationMap, Mount, Pose, Scene

FINISHING = ("fill", "terrain", "traversability")  # slots that work on the finished map


@dataclass(frozen=True)
class View:
    """One pair of a sequence."""

    pair: StereoPair
    pose: Pose
    time_s: float


@dataclass(frozen=True)
class FusedResult:
    """What a sequence gave.

    Attributes
    ----------
    elevation : ElevationMap
        See `modules.reconstruction.fuse_views.FusedMap.elevation`; with what the rules chose for fill, terrain and
        traversability.
    decisions : tuple of Decision
        One per view, in order.
    skipped : tuple of str
        Views that gave no points, and why.
    """

    elevation: ElevationMap
    decisions: tuple[Decision, ...]
    skipped: tuple[str, ...]

    def save(
        self,
        out: str | Path,
        *,
        products: Iterable[str] = (*DEFAULT_PRODUCTS, "layers.npz"),
        datum: Datum | None = None,
    ) -> None:
        """Write the products of the map and the decision of every view, whole or not at all.

        Raises
        ------
        modules.formats.FormatError
            The folder cannot be written, or a product is unknown or cannot be written.
        """
        chosen = check_products(products)
        with whole_folder(Path(out)) as folder:
            for name, write in product_writers(Terrain(self.elevation, None, datum, "fused map"), chosen).items():
                write(folder / name)
            (folder / "decisions").mkdir()
            for number, decision in enumerate(self.decisions):
                place = folder / "decisions" / f"{number:04d}.json"
                place.write_text(decision.to_json(), encoding="utf-8")


def fuse(
    system: ExpertSystem,
    views: Iterable[View],
    *,
    cell_m: float = 0.05,
    max_tiles: int = 64,
    progress: Callable[[str], None] | None = None,
) -> FusedResult:
    """Reconstruct each view and fuse the terrain into one map.

    Parameters
    ----------
    system : ExpertSystem
    views : iterable of View
        By time; taken one at a time, so a generator keeps the memory small.
    cell_m : float
        Cell of the map, m.
    max_tiles : int
        Tiles of 256 x 256 cells held in memory; the others go to a temporary folder.
    progress : callable, optional
        Called with what begins.

    Returns
    -------
    FusedResult

    Raises
    ------
    modules.operator.OperatorError
        No view gave points, the views are not sorted by time, or the map is too large.
    """
    decisions: list[Decision] = []
    skipped: list[str] = []
    last: Scene | None = None
    plan: StagePlan | None = None  # of the last view that gave points
    with tempfile.TemporaryDirectory() as folder:
        fused = FusedMap(cell_m, max_tiles, TileFolder(Path(folder)))
        for view in views:
            pair = replace(view.pair, attitude=view.pose.attitude)
            result = system.reconstruct(pair, progress=progress)
            decisions.append(result.decision)
            if result.points is None or len(result.points) == 0 or pair.calibration is None:
                reason = result.decision.findings[0].sentence if result.decision.findings else "no points"
                skipped.append(f"{pair.name}: {reason}")
                continue
            empty = Disparity(np.full((1, 1), np.nan, np.float32), np.ones((1, 1), np.uint16))
            last = Scene(empty, pair.left, pair.calibration, pair.attitude, pair.mount or Mount(), points=result.points)
            plan = result.decision.plans.get("reconstruction")
            fused.add(last, view.pose, view.time_s)
        if last is None:
            raise OperatorError(f"no view gave points ({'; '.join(skipped) or 'there are none'}); check the first one")
        elevation = fused.elevation()
    return FusedResult(_finished(replace(last, elevation=elevation), plan), tuple(decisions), tuple(skipped))


def _finished(scene: Scene, plan: StagePlan | None) -> ElevationMap:
    """Run on the map what the rules chose for the last view that gave points."""
    for step in plan.steps if plan is not None else ():
        if step.slot in FINISHING and step.operator != NONE:
            operator = operators()[step.operator]
            scene = operator.function(scene, operator.params(**step.parameters))
    if scene.elevation is None:
        raise OperatorError("the fused map was lost")
    return scene.elevation
