"""`terrex explain`: ask a saved decision how, why not, what if and what it would take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from expert.decision import Decision
from expert.engine import EngineName, make_engine
from expert.explain import ExplainError, check_digest
from expert.explain import how as tell_how
from expert.explain import what_if as tell_what_if
from expert.explain import what_would_it_take as tell_take
from expert.explain import why_not as tell_why_not
from expert.facts import vocabulary
from expert.firing import Engine
from expert.rules.load import LoadedRules, load_rules
from modules.catalog import operators, probes

Rules = Annotated[
    list[Path] | None,
    typer.Option("--rules", help="Rule file of the run, layered on the shipped rules"),
]


def explain(
    record: Annotated[Path, typer.Argument(metavar="DECISION", help="decision.json of a run, or of decide --json")],
    how: Annotated[
        list[str] | None, typer.Option("--how", metavar="SLOT", help="A stage, slot, operator of the plan, or finding")
    ] = None,
    why_not: Annotated[
        list[str] | None, typer.Option("--why-not", metavar="NAME", help="An operator or a rule")
    ] = None,
    what_if: Annotated[
        list[str] | None,
        typer.Option("--what-if", metavar="FACT.FIELD=VALUE", help="Plan again with another value; several together"),
    ] = None,
    take: Annotated[
        list[str] | None, typer.Option("--take", metavar="OPERATOR", help="An operator, or stage.slot=operator")
    ] = None,
    rules: Rules = None,
    engine: EngineName = "experta",
) -> None:
    """Explain a saved decision; without a question, tell how every choice came about."""
    try:
        decision = _read(record)
        loaded, motor = _knowledge(rules, engine)
        check_digest(decision, loaded)
        stages = [] if why_not or what_if or take else ["measurement", *decision.plans]
        texts = [tell_how(decision, name, loaded).text() for name in how or stages]
        texts += [tell_why_not(decision, loaded, name).text() for name in why_not or []]
        if what_if:
            texts.append(tell_what_if(decision, loaded, motor, _assignments(what_if)).text())
        texts += [tell_take(decision, loaded, motor, name).text() for name in take or []]
    except ExplainError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from error
    typer.echo("\n".join(texts), nl=False)


def _read(path: Path) -> Decision:
    try:
        return Decision.from_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ExplainError(f"{path}: cannot read the file: {error.strerror}") from error
    except ValueError as error:
        raise ExplainError(f"{path}: {error}") from error


def _knowledge(rules: list[Path] | None, engine: EngineName) -> tuple[LoadedRules, Engine]:
    words = vocabulary(probes().values())
    return load_rules(rules, words, operators(), probes()), make_engine(engine, words)


def _assignments(texts: list[str]) -> dict[str, str]:
    found = {}
    for text in texts:
        target, equals, value = text.rpartition("=")
        if not equals or not target:
            raise ExplainError(f"--what-if {text!r} is not FACT.FIELD=VALUE, e.g. brightness.offset_dn=0")
        found[target] = value
    return found
