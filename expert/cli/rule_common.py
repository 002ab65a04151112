"""What the commands of `terrex rules` share: the vocabulary, and loading with a sentence for the user."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, NoReturn, Optional

import typer

from expert.facts import Vocabulary, vocabulary
from expert.rules.load import LoadedRules, load_rules, shipped_file
from expert.rules.problem import RuleFileError, suggest
from modules.catalog import operators, probes

Layers = Annotated[
    Optional[list[Path]],  # noqa: UP045  typer reads the annotation at run time on Python 3.10
    typer.Option("--rules", help="Rule file layered on top of the shipped rules; may be repeated."),
]


def words() -> Vocabulary:
    """Return what rules may speak of."""
    return vocabulary(probes().values())


def load(rules: list[Path] | None, *, shipped: bool = True) -> LoadedRules:
    """Load the rules, or print what is wrong with them and leave."""
    try:
        return load_rules(rules, words(), operators(), probes(), shipped=shipped)
    except RuleFileError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(exit_code(error)) from error


def exit_code(error: RuleFileError) -> int:
    """Return 2 when a file cannot be read, else 1."""
    return 2 if any(problem.code == "unreadable" for problem in error.problems) else 1


def is_shipped(path: Path) -> bool:
    """Say whether a path is the file of the shipped rules."""
    shipped = shipped_file()
    return shipped is not None and path.exists() and path.samefile(shipped)


def known(loaded: LoadedRules, name: str) -> None:
    """Leave with a hint when there is no rule of that id."""
    if name not in loaded.merged.rules:
        refuse_unknown("rule", name, loaded.merged.rules)


def refuse_unknown(what: str, name: str, options: Iterable[str]) -> NoReturn:
    """Say that a name is unknown, with the nearest one, and leave with code 2."""
    hint = suggest(name, options)
    typer.echo(f"there is no {what} {name}" + (f"; {hint}" if hint else ""), err=True)
    raise typer.Exit(2)
