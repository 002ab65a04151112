"""`terrex log`: ask the log of a batch."""

from __future__ import annotations

import csv
import io
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from expert.cli.log_names import check_names
from expert.cli.usage import UsageError

Format = Literal["text", "csv", "json", "parquet"]
Rows = Sequence[Sequence[object]]
COLUMNS = "r.pair, r.status, r.reason, r.score, round(r.seconds, 3) AS seconds, r.decision_id, r.finished"


def log(
    folder: Annotated[Path, typer.Argument(help="Folder that `terrex batch --out` wrote")],
    status: Annotated[str | None, typer.Option(help="Pairs of this status, e.g. failed, unreadable, timeout")] = None,
    rule: Annotated[str | None, typer.Option(help="Pairs for which this rule fired")] = None,
    not_rule: Annotated[str | None, typer.Option(help="Pairs for which this rule did not fire")] = None,
    finding: Annotated[str | None, typer.Option(help="Pairs with this finding")] = None,
    operator: Annotated[str | None, typer.Option(help="Pairs whose plan has this operator")] = None,
    slowest: Annotated[int | None, typer.Option(metavar="N", help="The N slowest pairs")] = None,
    changed: Annotated[bool, typer.Option("--changed", help="Pairs whose decision changed between runs")] = False,
    rules: Annotated[bool, typer.Option("--rules", help="How often each rule fired")] = False,
    runs: Annotated[bool, typer.Option("--runs", help="The runs, with their settings and versions")] = False,
    fact: Annotated[
        str | None, typer.Option(help="A fact of every pair, e.g. brightness.gain; * stands for any")
    ] = None,
    sql: Annotated[str | None, typer.Option(help="A query of your own; it cannot change anything")] = None,
    format_: Annotated[Format, typer.Option("--format", help="parquet needs the extra 'parquet' and --out")] = "text",
    out: Annotated[Path | None, typer.Option(help="File to write instead of the terminal")] = None,
) -> None:
    """Ask the log of a batch which pairs, rules and facts; without a question, list all pairs."""
    from expert.batch.runlog import NAME, RunLog

    text, values = _query(status, rule, not_rule, finding, operator, slowest, changed, rules, runs, fact, sql)
    base = RunLog(folder / NAME, read_only=True)
    check_names(base, status=status, rules=(rule, not_rule), finding=finding, operator=operator, fact=fact)
    names, found = base.query(text, values)
    if format_ == "parquet":
        if out is None:
            raise UsageError("--format parquet needs --out FILE")
        _parquet(out, names, found)
        return
    shown = {"text": _text, "csv": _csv, "json": _json}[format_](names, found)
    if out is None:
        sys.stdout.write(shown)
    else:
        from modules.formats._text import write_text

        write_text(out, shown)


def _query(
    status: str | None,
    rule: str | None,
    not_rule: str | None,
    finding: str | None,
    operator: str | None,
    slowest: int | None,
    changed: bool,
    rules: bool,
    runs: bool,
    fact: str | None,
    sql: str | None,
) -> tuple[str, list[object]]:
    """Return the query that the options ask for, and its values."""
    if sql is not None:
        return sql, []
    if runs:
        return "SELECT run, started, ended, source, settings, versions FROM runs ORDER BY run", []
    if rules:
        return (
            "SELECT f.rule, count(DISTINCT f.result) AS pairs FROM firings f JOIN results r USING (result) "
            "WHERE r.latest = 1 GROUP BY f.rule ORDER BY pairs DESC, f.rule",
            [],
        )
    if changed:
        return (
            "SELECT pair, count(DISTINCT decision_id) AS decisions, group_concat(DISTINCT decision_id) AS ids "
            "FROM results WHERE decision_id != '' GROUP BY pair HAVING decisions > 1 ORDER BY pair",
            [],
        )
    if fact is not None:
        return (
            "SELECT r.pair, f.fact, f.value FROM facts f JOIN results r USING (result) WHERE r.latest = 1 AND "
            "f.fact GLOB ? ORDER BY f.fact, r.pair",
            [fact.replace("[", "[[]")],
        )
    within = "EXISTS (SELECT 1 FROM {} x WHERE x.result = r.result AND x.{} = ?)"
    conditions: list[str] = ["r.latest = 1"]
    values: list[object] = []
    for value, condition in (
        (status, "r.status = ?"),
        (rule, within.format("firings", "rule")),
        (not_rule, "NOT " + within.format("firings", "rule")),
        (finding, within.format("findings", "finding")),
        (operator, within.format("steps", "operator")),
    ):
        if value is not None:
            conditions.append(condition)
            values.append(value)
    order = "r.pair" if slowest is None else f"r.seconds DESC LIMIT {int(slowest)}"
    return f"SELECT {COLUMNS} FROM results r WHERE {' AND '.join(conditions)} ORDER BY {order}", values


def _text(names: Sequence[str], rows: Rows) -> str:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    buffer = io.StringIO()
    console = Console(file=buffer, width=200, no_color=True)
    table = Table(*names, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*(Text("" if value is None else str(value)) for value in row))
    console.print(table)
    console.print(f"{len(rows)} rows")
    return "\n".join(line.rstrip() for line in buffer.getvalue().splitlines()) + "\n"


def _csv(names: Sequence[str], rows: Rows) -> str:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    return buffer.getvalue()


def _json(names: Sequence[str], rows: Rows) -> str:
    data = [dict(zip(names, row, strict=True)) for row in rows]
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _parquet(path: Path, names: Sequence[str], rows: Rows) -> None:

    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError("--format parquet needs the extra 'parquet': pip install 'terrex[parquet]'") from error
    columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
