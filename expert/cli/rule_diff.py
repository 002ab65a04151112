"""`terrex rules diff`: what two rule files mean differently, and which recorded decisions that changes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal, Optional

import typer

from expert.cli.rule_common import is_shipped, load, words
from expert.engine import make_engine
from expert.redecide import Redecision, read_records, redecide
from expert.rules.diff import rule_differences
from expert.rules.load import LoadedRules


def diff(
    old: Annotated[Path, typer.Argument(metavar="A", help="Rule file; `shipped` for the shipped rules.")],
    new: Annotated[Path, typer.Argument(metavar="B", help="Rule file; `shipped` for the shipped rules.")],
    alone: Annotated[
        bool, typer.Option("--alone", help="Both are whole rule bases, not layers on the shipped rules.")
    ] = False,
    records: Annotated[
        Optional[Path],  # noqa: UP045  typer reads the annotation at run time on Python 3.10
        typer.Option("--records", help="Folder of decision records to decide again with both."),
    ] = None,
    form: Annotated[Literal["text", "json"], typer.Option("--format", help="How to write it.")] = "text",
) -> None:
    """Say what changed in meaning from A to B; leave with 1 when recorded decisions change or cannot be read."""
    before, after = _side(old, alone), _side(new, alone)
    differences = rule_differences(before.base, after.base, words())
    decisions, problems = _redecide(records, before, after) if records else ([], [])
    changed = [item for item in decisions if item.changes]
    if form == "json":
        data = {
            "rules": [item.as_dict() for item in differences],
            "decisions": [
                {"file": item.file, "pair": item.pair, "changes": item.changes, "not_measured": item.unknown}
                for item in decisions
            ],
            "problems": problems,
        }
        typer.echo(json.dumps(data, indent=2, ensure_ascii=False))
    else:
        for item in differences:
            typer.echo(str(item))
        if not differences:
            typer.echo("no difference in meaning")
        if records:
            _tell(decisions, changed)
    for problem in problems:
        typer.echo(problem, err=True)
    if changed or problems:
        raise typer.Exit(1)


def _side(path: Path, alone: bool) -> LoadedRules:
    if str(path) == "shipped" or is_shipped(path):
        return load(None)
    return load([path], shipped=not alone)


def _redecide(folder: Path, before: LoadedRules, after: LoadedRules) -> tuple[list[Redecision], list[str]]:
    found, problems = read_records(folder)
    if not found and not problems:
        typer.echo(f"there is no decision record in {folder}; terrex run and terrex decide --json write them", err=True)
        raise typer.Exit(2)
    engine = make_engine("compiled", words())
    return [redecide(file, decision, before, after, engine) for file, decision in found], problems


def _tell(decisions: list[Redecision], changed: list[Redecision]) -> None:
    typer.echo(f"\n{len(changed)} of {len(decisions)} recorded decisions change")
    for item in changed:
        typer.echo(f"{item.file} ({item.pair})")
        for change in item.changes:
            typer.echo(f"  {change}")
        for probe in item.unknown:
            typer.echo(f"  note: {probe} would be asked for, but was not run, so its facts are unknown")
