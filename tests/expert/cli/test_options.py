"""Groups of options: every command that takes one has the same options, and gets them as one value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer
from typer.testing import CliRunner

from expert.cli.options import expanded

Length = Annotated[float, typer.Option("--length", help="m")]


@dataclass(frozen=True)
class Inner:
    length: Length = 1.0


@dataclass(frozen=True)
class Outer:
    name: Annotated[str, typer.Argument()]
    inner: Inner
    wide: bool = False


def made() -> tuple[typer.Typer, list[tuple[Outer, int]]]:
    app, taken = typer.Typer(), []

    @app.command()
    @expanded
    def command(outer: Outer, count: int = 3) -> None:
        taken.append((outer, count))

    return app, taken


def test_a_command_gets_the_groups_it_asks_for() -> None:
    app, taken = made()
    assert CliRunner().invoke(app, ["rock", "--length", "2.5", "--wide", "--count", "4"]).exit_code == 0
    assert taken == [(Outer("rock", Inner(2.5), wide=True), 4)]


def test_options_that_are_not_given_have_the_defaults_of_their_group() -> None:
    app, taken = made()
    assert CliRunner().invoke(app, ["rock"]).exit_code == 0
    assert taken == [(Outer("rock", Inner(1.0)), 3)]


def test_the_help_lists_options_of_groups_within_groups() -> None:
    said = CliRunner().invoke(made()[0], ["--help"]).output
    assert all(word in said for word in ("--length", "--wide", "--count", "{name}"))
