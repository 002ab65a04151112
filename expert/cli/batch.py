"""`terrex batch`: many pairs, with a log that survives whatever happens."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from expert.cli import check_interrupt
from expert.cli.options import (
    AttitudeOptions,
    BudgetOptions,
    CameraOptions,
    RangeOption,
    SystemOptions,
    expanded,
)
from expert.cli.terrain_options import DatumOption, MaskOption, ProductsOption, RoverOption
from expert.cli.usage import UsageError

if TYPE_CHECKING:
    from expert.batch import BatchItem, Limits, Outcome, Plan, Progress, Stated
    from modules.types import Datum

TimeUnit = Literal["s", "ms", "us", "ns"]


@dataclass(frozen=True)
class LimitOptions:
    """Where the pairs are processed, and what a worker may take."""

    jobs: Annotated[int, typer.Option(help="Worker processes on this machine")] = 1
    timeout: Annotated[float | None, typer.Option(help="Longest time for a pair, s")] = None
    memory_limit: Annotated[int | None, typer.Option(help="Most memory for a worker, MB")] = None
    threads: Annotated[int, typer.Option(help="Threads per worker")] = 1
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler; needs the extra 'distributed'")
    ] = None
    transfer: Annotated[
        Literal["path", "bytes"], typer.Option(help="Whether workers share the paths, or get and return contents")
    ] = "path"

    def limits(self) -> Limits:
        """Return the limits of a worker.

        Raises
        ------
        UsageError
            A number makes no sense, or the workers are not this program's.
        """
        from expert.batch import Limits

        whole = (("--jobs", self.jobs), ("--threads", self.threads), ("--memory-limit", self.memory_limit))
        for name, value in whole:
            if value is not None and value < 1:
                raise UsageError(f"{name} {value} is below 1; give 1 or more")
        if self.timeout is not None and self.timeout <= 0:
            raise UsageError(f"--timeout {self.timeout:g} is not positive; give seconds")
        if self.scheduler is not None and (self.timeout is not None or self.memory_limit is not None):
            raise UsageError(
                "--timeout and --memory-limit bind workers on this machine; give the limits to `dask worker` "
                "(--memory-limit, --lifetime) instead"
            )
        return Limits(self.timeout, self.memory_limit, self.threads)


@dataclass(frozen=True)
class ChoiceOptions:
    """Which pairs of the source are processed."""

    pattern: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="LEFT RIGHT", help="Patterns with one * each, e.g. 'l/*.png' 'r/*.png'"),
    ] = None
    filter_: Annotated[str | None, typer.Option("--filter", help="Only pairs whose name matches, e.g. 'day1/*'")] = None
    limit: Annotated[int | None, typer.Option(help="Only the first N pairs")] = None

    def of(self, source: Path) -> tuple[BatchItem, ...]:
        """Return the chosen pairs of a source.

        Raises
        ------
        UsageError
            There is none.
        """
        from expert.batch import find_pairs, select

        if self.limit is not None and self.limit < 1:
            raise UsageError(f"--limit {self.limit} is below 1; give 1 or more")
        items = select(find_pairs(source, self.pattern), self.filter_, self.limit)
        if not items:
            raise UsageError(f"no pair of {source} matches --filter {self.filter_!r}")
        return items


@expanded
def batch(
    source: Annotated[Path, typer.Argument(help="Folder of pairs, or a manifest (.csv, .jsonl)")],
    out: Annotated[Path, typer.Option(help="Folder of the results; the same command goes on where it was")],
    chosen: ChoiceOptions,
    at: LimitOptions,
    system: SystemOptions,
    budgets: BudgetOptions,
    cameras: CameraOptions,
    level: AttitudeOptions,
    time_in_name: Annotated[
        TimeUnit | None, typer.Option(help="The number at the end of a name is the time of the pair, in this unit")
    ] = None,
    disparity_range: RangeOption = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and do nothing")] = False,
    resume: Annotated[
        Literal["ask", "redo", "keep"],
        typer.Option(help="What to do with pairs that were processed with other rules, versions, profile, ..."),
    ] = "ask",
    retry: Annotated[bool, typer.Option("--retry", help="Try again what could not be processed")] = False,
    html: Annotated[bool, typer.Option(help="Write a report.html for every pair")] = True,
    products: ProductsOption = None,
    rover: RoverOption = None,
    datum: DatumOption = None,
    mask: MaskOption = None,
) -> None:
    """Reconstruct many pairs; an interrupted batch goes on where it was.

    What is said of calibration, attitude, range, datum and mask holds for the pairs that state nothing else.
    """
    from expert.batch import Batch, ChangedSettings, Settings, timed
    from expert.cli.terrain_options import stated_datum, stated_products, stated_rover

    limits, items = at.limits(), chosen.of(source)
    settings = Settings(
        tuple(str(path.resolve()) for path in system.rules or []),
        system.profile,
        system.engine,
        stated_rover(rover),
        budgets.time_budget,
        budgets.memory_budget,
        products=stated_products(products),
        html=html,
        common=_common(cameras, level, disparity_range, mask, stated_datum(datum)),
    )
    made = Batch(items if level.imu is None else timed(items, time_in_name), out, settings, str(source))
    try:
        plan = made.plan("redo" if dry_run and resume == "ask" else resume, retry=retry)
    except ChangedSettings as error:
        raise UsageError(str(error)) from error
    if dry_run:
        typer.echo(_planned(plan), nl=False)
        return
    check_interrupt()
    with _shown(len(plan.todo)) as progress:
        state = made.run(
            plan,
            jobs=at.jobs,
            limits=limits,
            scheduler=at.scheduler,
            transfer=at.transfer,
            progress=progress,
            interrupted=_interrupted,
        )
    _conclude(out, plan, state)


def _interrupted() -> None:
    """Say what the first interrupt does."""
    typer.echo(
        "interrupted: the pairs in work are finished first; interrupt once more to give them up. The same command "
        "goes on where this one ends",
        err=True,
    )


def _common(
    cameras: CameraOptions,
    level: AttitudeOptions,
    disparity_range: tuple[int, int] | None,
    mask: Path | None,
    datum: Datum | None,
) -> Stated:
    """Return what the options state for all pairs, by paths that workers elsewhere can use."""
    from expert.batch import Stated

    return Stated(
        tuple(path.resolve() for path in cameras.calibration or ()),
        None if level.attitude is None else level.attitude.resolve(),
        level.angles_deg(),
        None if level.imu is None else level.imu.resolve(),
        None,
        disparity_range,
        cameras.rectified,
        cameras.scale_calibration,
        cameras.alpha,
        level.convention,
        None if mask is None else mask.resolve(),
        None if datum is None else (datum.latitude_deg, datum.longitude_deg),
        level.max_gap,
    )


def _conclude(out: Path, plan: Plan, state: Progress) -> None:
    """Say what became of the batch, and leave with 1 where something is left to do or to look at."""
    from expert.batch.page import write_page

    left = state.total - state.done
    typer.echo(
        f"{state.done} pairs processed, {_kept(plan)} kept, {state.failed} could not be reconstructed, "
        f"{state.not_processed} could not be processed" + (f", {left} left" if left else "")
    )
    typer.echo(f"written to {write_page(out)}; ask `terrex log {out}` for more")
    if state.not_processed or plan.unprocessed:
        typer.echo("the same command with --retry tries again what could not be processed")
    if state.failed or state.not_processed or plan.unprocessed or left:
        raise typer.Exit(1)


def _kept(plan: Plan) -> str:
    told = f" ({plan.unprocessed} of them could not be processed)" if plan.unprocessed else ""
    return f"{plan.done}{told}"


def _planned(plan: Plan) -> str:
    lines = [f"{reason}: {item.name!r}" for item, reason in plan.todo]
    counts: dict[str, int] = {}
    for _, reason in plan.todo:
        counts[reason] = counts.get(reason, 0) + 1
    told = ", ".join(f"{count} {reason}" for reason, count in sorted(counts.items())) or "nothing"
    lines.append(f"to do: {told}; {_kept(plan)} are done")
    if plan.changes:
        lines.append(
            f"processed otherwise: {'; '.join(plan.changes)}; --resume keep leaves them, --resume redo does not"
        )
    return "\n".join(lines) + "\n"


@contextmanager
def _shown(total: int) -> Iterator[Callable[[Progress, Outcome], None]]:
    """Show a bar with rate, remaining time and failures on a terminal, and a line per pair in a pipe."""
    if not sys.stderr.isatty():
        yield _line
        return
    from rich.logging import RichHandler
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    start = time.monotonic()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[bad]}"),
    )
    with Bar(*columns) as bar:
        logging.basicConfig(handlers=[RichHandler(console=bar.console)], level=logging.WARNING, force=True)
        task = bar.add_task("pairs", total=total, rate="", bad="")

        def show(progress: Progress, outcome: Outcome) -> None:
            rate = f"{progress.done / max(time.monotonic() - start, 1e-6):.1f}/s"
            bad = f"{progress.failed} failed, {progress.not_processed} not processed"
            bar.update(task, completed=progress.done, rate=rate, bad=bad)

        yield show


def _line(progress: Progress, outcome: Outcome) -> None:
    told = f" ({outcome.reason})" if outcome.status not in ("reconstructed", "disparity_only") else ""
    name = outcome.name.replace("\n", "\\n")
    typer.echo(f"{progress.done}/{progress.total} {name}: {outcome.status} in {outcome.seconds:.2f} s{told}", err=True)
