"""`terrex batch`: many pairs, with a log that survives whatever happens."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from expert.cli.usage import UsageError

if TYPE_CHECKING:
    from expert.batch import Outcome, Plan, Progress

Profile = Literal["fast", "balanced", "best"]
EngineName = Literal["experta", "compiled"]


def batch(
    source: Annotated[Path, typer.Argument(help="Folder of pairs, or a manifest (.csv, .jsonl)")],
    out: Annotated[Path, typer.Option(help="Folder of the results; the same command goes on where it was")],
    jobs: Annotated[int, typer.Option(help="Worker processes")] = 1,
    pattern: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="LEFT RIGHT", help="Patterns with one * each, e.g. 'l/*.png' 'r/*.png'"),
    ] = None,
    filter_: Annotated[
        str | None, typer.Option("--filter", help="Only pairs whose name matches, e.g. 'day1/*'")
    ] = None,
    limit: Annotated[int | None, typer.Option(help="Only the first N pairs")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and do nothing")] = False,
    resume: Annotated[
        Literal["ask", "redo", "keep"],
        typer.Option(help="What to do with pairs that were processed with other rules, versions or profile"),
    ] = "ask",
    retry: Annotated[bool, typer.Option("--retry", help="Try again what could not be processed")] = False,
    rules: Annotated[list[Path] | None, typer.Option(help="Rule file layered on the shipped rules")] = None,
    profile: Profile = "balanced",
    engine: EngineName = "experta",
    calibration: Annotated[Path | None, typer.Option(help="For the pairs that have none of their own")] = None,
    attitude: Annotated[Path | None, typer.Option(help="For the pairs that have none of their own")] = None,
    disparity_range: Annotated[
        tuple[int, int] | None, typer.Option(metavar="MIN MAX", help="px, for all pairs")
    ] = None,
    html: Annotated[bool, typer.Option(help="Write a report.html for every pair")] = True,
    timeout: Annotated[float | None, typer.Option(help="Longest time for a pair, s")] = None,
    memory_limit: Annotated[int | None, typer.Option(help="Most memory for a worker, MB")] = None,
    threads: Annotated[int, typer.Option(help="Threads per worker")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler; needs the extra 'distributed'")
    ] = None,
    transfer: Annotated[
        Literal["path", "bytes"], typer.Option(help="Whether workers share the paths, or get and return contents")
    ] = "path",
) -> None:
    """Reconstruct many pairs; an interrupted batch goes on where it was."""
    from expert.batch import Batch, ChangedSettings, Limits, Settings, find_pairs, select
    from expert.batch.page import write_page

    for name, value in (("--jobs", jobs), ("--limit", limit), ("--threads", threads), ("--memory-limit", memory_limit)):
        if value is not None and value < 1:
            raise UsageError(f"{name} {value} is below 1; give 1 or more")
    if timeout is not None and timeout <= 0:
        raise UsageError(f"--timeout {timeout:g} is not positive; give seconds")
    items = select(find_pairs(source, pattern), filter_, limit)
    if not items:
        raise UsageError(f"no pair of {source} matches --filter {filter_!r}")
    settings = Settings(
        tuple(str(path.resolve()) for path in rules or []),
        profile,
        engine,
        _absolute(calibration),
        _absolute(attitude),
        disparity_range,
        html,
    )
    made = Batch(items, out, settings, str(source))
    try:
        plan = made.plan(resume, retry=retry)
    except ChangedSettings as error:
        raise UsageError(str(error)) from error
    if dry_run:
        typer.echo(_planned(plan), nl=False)
        return
    limits = Limits(timeout, memory_limit, threads)
    with _shown(len(plan.todo)) as progress:
        state = made.run(plan, jobs=jobs, limits=limits, scheduler=scheduler, transfer=transfer, progress=progress)
    write_page(out)
    left = state.total - state.done
    typer.echo(
        f"{state.done} pairs processed, {plan.done} kept, {state.failed} could not be reconstructed, "
        f"{state.not_processed} could not be processed" + (f", {left} left" if left else "")
    )
    typer.echo(f"written to {out / 'index.html'}; ask `terrex log {out}` for more")
    if state.failed or state.not_processed or left:
        raise typer.Exit(1)


def _absolute(path: Path | None) -> str | None:
    return None if path is None else str(path.resolve())


def _planned(plan: Plan) -> str:
    lines = [f"{reason}: {item.name!r}" for item, reason in plan.todo]
    counts: dict[str, int] = {}
    for _, reason in plan.todo:
        counts[reason] = counts.get(reason, 0) + 1
    told = ", ".join(f"{count} {reason}" for reason, count in sorted(counts.items())) or "nothing"
    return "\n".join([*lines, f"to do: {told}; {plan.done} are done"]) + "\n"


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
