"""`terrex rules diff`: what two rule files mean differently, and which recorded decisions that changes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal, Optional

import typer

from expert.cli.rule_common import is_shipped, load, words
from expert.engine import make_engine
from expert.facts import Fact
from expert.redecide import Redecision, read_records, redecide
from expert.rules.cases import facts_of, read_cases
from expert.rules.counterexample import Counterexample, counterexamples
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
        typer.Option("--pairs", help="Folder of decision records to decide again with both."),
    ] = None,
    cases: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--cases", help="Directory of the case files of A and B; examples begin with their facts."),
    ] = None,
    form: Annotated[Literal["text", "json"], typer.Option("--format", help="How to write it.")] = "text",
) -> None:
    """Say what changed in meaning from A to B, with facts on which a rule does something else.

    Leave with 1 when recorded decisions change or cannot be read.
    """
    before, after = _side(old, alone), _side(new, alone)
    differences = rule_differences(before.base, after.base, words())
    examples = _examples(before, after, cases)
    decisions, problems = _redecide(records, before, after) if records else ([], [])
    changed = [item for item in decisions if item.changes]
    if form == "json":
        data = {
            "rules": [item.as_dict() for item in differences],
            "examples": [item.as_dict() for item in examples],
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
        for example in examples:
            typer.echo(str(example))
        if records:
            _tell(decisions, changed)
    for problem in problems:
        typer.echo(problem, err=True)
    if changed or problems:
        raise typer.Exit(1)


def _examples(before: LoadedRules, after: LoadedRules, folder: Path | None) -> list[Counterexample]:
    """Look for facts on which changed rules do something else, beginning with those of the cases."""
    vocabulary = words()
    given: dict[str, list[frozenset[Fact]]] = {}
    for side in (before, after):
        for place in (None, folder) if folder else (None,):
            for file in read_cases(side.merged, vocabulary, place)[0]:
                given.setdefault(file.rule, []).extend(facts_of(case) for case, _ in file.cases)
    return counterexamples(before.base, after.base, vocabulary, make_engine("compiled", vocabulary), given)


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
