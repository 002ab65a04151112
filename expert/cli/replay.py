"""`terrex replay`: run a saved plan again and compare what it gives with the record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from expert.cli.explain import read_record
from expert.cli.options import CameraOptions, Left, Right, expanded
from expert.cli.usage import UsageError
from expert.plan import PlanError, StepFailed
from expert.replay import Replayed, ReplayError, as_recorded, load_recorded_pair, replay
from modules.formats.disparity import read_pfm
from modules.formats.errors import FormatError


@expanded
def replay_command(
    record: Annotated[Path, typer.Argument(metavar="DECISION", help="decision.json of a run, or of decide --json")],
    left: Left,
    right: Right,
    cameras: CameraOptions,
    out: Annotated[Path | None, typer.Option(help="Folder for the products; appears whole or not at all")] = None,
) -> None:
    """Run exactly the saved plan, without any rule, and say whether inputs and products are those of the record.

    Calibration, attitude and range are taken from the record; images that were rectified while they were loaded need
    the calibration of that run.
    """
    decision = read_record(record)
    try:
        if cameras.calibration:
            pair = as_recorded(cameras.load(left, right), decision.inputs)
        else:
            pair = load_recorded_pair(decision.inputs, left, right)
        replayed = replay(decision, pair)
    except (ReplayError, StepFailed, PlanError) as error:
        raise UsageError(f"{record}: {error}") from error
    if out is not None:
        replayed.result.save(out)
    typer.echo(replayed.text(), nl=False)
    difference = _difference(record.parent, replayed)
    if difference:
        typer.echo(difference)
    if not replayed.same:
        raise typer.Exit(1)


def _difference(folder: Path, replayed: Replayed) -> str:
    """Say by how much the disparity differs from the one saved beside the record, where there is one."""
    path = folder / "disparity.pfm"
    if replayed.same or not path.is_file() or replayed.result.disparity is None:
        return ""
    try:
        saved, found = read_pfm(path), replayed.result.disparity_px
    except FormatError:
        return ""
    if saved.shape != found.shape:
        return f"the saved disparity is {saved.shape[1]}x{saved.shape[0]}, this one {found.shape[1]}x{found.shape[0]}"
    both = np.isfinite(saved) & np.isfinite(found)
    only = float((np.isfinite(saved) != np.isfinite(found)).mean())
    moved = np.abs(saved - found)[both]
    largest = float(moved.max()) if moved.size else 0.0
    changed = float((moved > 0).mean()) if moved.size else 0.0
    return (
        f"disparity against {path}: valid in one only {100 * only:.2g} % of the pixels, "
        f"other value {100 * changed:.2g} % of the rest, largest difference {largest:.3g} px"
    )
