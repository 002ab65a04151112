"""`terrex report`: render the report of a saved run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that `terrex run --out` wrote")],
    text: Annotated[bool, typer.Option("--text", help="Print it here instead, and write nothing")] = False,
) -> None:
    """Write report.html and report.md of a saved run again; the same version gives the same bytes."""
    from expert.report import as_text, read_decision, render_again

    if text:
        typer.echo(as_text(read_decision(folder)), nl=False)
        return
    for path in render_again(folder):
        typer.echo(f"written {path}")
