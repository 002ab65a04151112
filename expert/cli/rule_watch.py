"""`terrex rules watch`: decide about a pair again whenever a rule file is saved."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Optional

import typer

from expert.cli.options import EngineName, PairOptions, Profile, expanded
from expert.cli.rule_common import Layers
from expert.rules.load import shipped_file

INTERVAL_S = 0.2


@expanded
def watch(
    pair: PairOptions,
    rules: Layers = None,
    profile: Profile = "balanced",
    engine: EngineName = "compiled",
    saves: Annotated[Optional[int], typer.Option(help="End after so many saves; by Ctrl-C without.")] = None,  # noqa: UP045
) -> None:
    """Measure a pair once, decide about it, and decide again whenever a rule file is saved."""
    from expert.api import ExpertSystem
    from expert.watch import Watch

    shipped = shipped_file()
    files = [*([shipped] if shipped else []), *(rules or [])]
    watched = Watch(pair.load(), lambda: ExpertSystem(rules=rules or [], profile=profile, engine=engine))
    first = watched.look()
    typer.echo("\n".join(first) if watched.decision is None else watched.decision.text().rstrip())
    typer.echo(f"\nwatching {', '.join(str(file) for file in files)}; end with Ctrl-C")
    try:
        follow(watched.look, files, saves)
    except KeyboardInterrupt:
        typer.echo("")
    if watched.decision is None:
        raise typer.Exit(1)


def follow(
    look: Callable[[], tuple[str, ...]],
    files: list[Path],
    saves: int | None,
    wait: Callable[[], None] = lambda: clock.sleep(INTERVAL_S),
) -> None:
    """Look again after every save of one of the files, and say what came of it."""
    from expert.watch import stamp

    seen, count = stamp(files), 0
    while saves is None or count < saves:
        wait()
        now = stamp(files)
        if now == seen:
            continue
        seen, count = now, count + 1
        if None in now:
            continue  # between two steps of an editor
        start = clock.perf_counter()
        lines = look()
        took = 1e3 * (clock.perf_counter() - start)
        typer.echo(f"\n{clock.strftime('%H:%M:%S')}  decided again in {took:.0f} ms")
        for line in lines:
            typer.echo("  " + line.replace("\n", "\n  "))
