"""`terrex explain`: ask a saved decision how, why not, what if and what it would take."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from expert.cli.usage import UsageError
from expert.decision import Decision, record_schema
from expert.explain import ExplainError
from expert.explain.prov import as_prov
from expert.plan import PlanError, Record


def explain(
    record: Annotated[
        Path | None, typer.Argument(metavar="DECISION", help="decision.json of a run, or of decide --json")
    ] = None,
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
    margins: Annotated[
        bool, typer.Option("--margins", help="How near every measured value was to the limits of the rules")
    ] = False,
    prov: Annotated[bool, typer.Option("--prov", help="Print where everything came from as W3C PROV-JSON")] = False,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON Schema of decision.json")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the answers as a JSON list")] = False,
) -> None:
    """Explain a saved decision by the rules it carries; without a question, tell how every choice came about."""
    if schema:
        typer.echo(json.dumps(record_schema(), indent=1))
        return
    if record is None:
        raise UsageError("give the decision.json to explain")
    decision = read_record(record)
    if prov:
        typer.echo(json.dumps(as_prov(decision), indent=1, ensure_ascii=False))
        return
    asked: list[Callable[[], Record]] = [lambda name=name: decision.how(name) for name in how or ()]  # type: ignore[misc]
    asked += [lambda name=name: decision.why_not(name) for name in why_not or ()]  # type: ignore[misc]
    asked += [lambda: decision.what_if(_assignments(what_if or []))] if what_if else []
    asked += [lambda name=name: decision.what_would_it_take(name) for name in take or ()]  # type: ignore[misc]
    asked += [decision.margins] if margins else []
    if not asked:
        stages = ["measurement", *decision.plans]
        asked = [lambda name=name: decision.how(name) for name in stages]  # type: ignore[misc]
    try:
        answers = [question() for question in asked]
    except (ExplainError, PlanError) as error:
        raise UsageError(str(error)) from error
    if as_json:
        typer.echo(json.dumps([answer.model_dump(mode="json") for answer in answers], indent=1, ensure_ascii=False))
    else:
        typer.echo("\n".join(answer.text() for answer in answers), nl=False)  # type: ignore[attr-defined]


def read_record(path: Path) -> Decision:
    """Read a decision record.

    Raises
    ------
    UsageError
        There is no such file, or it is no record.
    """
    try:
        return Decision.from_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot read the file: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"{path}: {error}") from error


def _assignments(texts: list[str]) -> dict[str, str]:
    found = {}
    for text in texts:
        target, equals, value = text.rpartition("=")
        if not equals or not target:
            raise UsageError(f"--what-if {text!r} is not FACT.FIELD=VALUE, e.g. brightness.offset_dn=0")
        found[target] = value
    return found
