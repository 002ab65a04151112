"""`terrex rules`: check, test, explain and show rule files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal, Optional

import typer

from expert.cli import rule_diff, rule_watch, rule_writing
from expert.cli.rule_common import Layers, exit_code, is_shipped, known, load, words
from expert.engine import EngineName, make_engine
from expert.facts import Vocabulary
from expert.rules.cases import read_cases, run_cases
from expert.rules.check import as_json, check_rules
from expert.rules.coverage import coverage
from expert.rules.explain import sentence
from expert.rules.layers import written_in
from expert.rules.load import LoadedRules
from expert.rules.missing import missing_cases
from expert.rules.model import STAGES
from expert.rules.problem import RuleFileError
from expert.rules.sarif import as_sarif
from expert.rules.schema import json_schema
from modules.catalog import operators, probes

app = typer.Typer(help="Check, test, explain and show rule files.", no_args_is_help=True)


@app.command()
def check(
    files: Annotated[
        Optional[list[Path]],  # noqa: UP045
        typer.Argument(help="Rule files, layered in this order; the shipped rules without any."),
    ] = None,
    alone: Annotated[bool, typer.Option("--alone", help="Do not put the shipped rules below the files.")] = False,
    cases: Annotated[Optional[Path], typer.Option("--cases", help="Directory of the case files.")] = None,  # noqa: UP045
    no_cases: Annotated[bool, typer.Option("--no-cases", help="Do not ask for cases.")] = False,
    form: Annotated[Literal["text", "json", "sarif"], typer.Option("--format", help="How to write it.")] = "text",
    as_data: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
) -> None:
    """Report every problem of rule files, with line and column; notes are no problems."""
    alone = alone or any(is_shipped(path) for path in files or [])
    problems = check_rules(
        files, words(), operators(), probes(), shipped=not alone, cases=cases, with_cases=not no_cases
    )
    if form == "sarif":
        typer.echo(as_sarif(problems))
    elif as_data or form == "json":
        typer.echo(as_json(problems))
    else:
        for problem in problems:
            typer.echo(str(problem))
        if all(problem.level == "note" for problem in problems):
            typer.echo("no problems")
    if any(problem.code == "unreadable" for problem in problems):
        raise typer.Exit(2)
    if any(problem.level != "note" for problem in problems):
        raise typer.Exit(1)


@app.command("test")
def run_rule_cases(
    ids: Annotated[Optional[list[str]], typer.Argument(help="Rule ids; all rules without any.")] = None,  # noqa: UP045
    rules: Layers = None,
    cases: Annotated[Optional[Path], typer.Option("--cases", help="Directory of the case files.")] = None,  # noqa: UP045
    show_coverage: Annotated[
        bool, typer.Option("--coverage", help="Also say which rules, conditions and actions lack cases.")
    ] = False,
    missing: Annotated[
        bool, typer.Option("--missing", help="Also print cases at the limits that no case touches.")
    ] = False,
    engine: Annotated[str, typer.Option("--engine", help="compiled or experta.")] = "compiled",
) -> None:
    """Run the cases of rules."""
    loaded, vocabulary = load(rules), words()
    for name in ids or []:
        known(loaded, name)
    try:
        results = run_cases(loaded, make_engine(_engine_name(engine), vocabulary), vocabulary, ids or None, cases)
    except RuleFileError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(exit_code(error)) from error
    failed = [result for result in results if not result.passed]
    for result in failed:
        typer.echo(str(result))
    typer.echo(f"{len(results)} cases, {len(failed)} failed")
    complete = True
    if show_coverage:
        files, _ = read_cases(loaded.merged, vocabulary, cases, ids or None)
        runner = make_engine("compiled", vocabulary)
        found = coverage(loaded, runner, results, files, vocabulary, ids or None)
        complete = found.complete
        for line in found.lines():
            typer.echo(line)
    if missing:
        _print_missing(loaded, vocabulary, ids, cases)
    if failed or not complete:
        raise typer.Exit(1)


def _print_missing(loaded: LoadedRules, vocabulary: Vocabulary, ids: list[str] | None, cases: Path | None) -> None:
    files, _ = read_cases(loaded.merged, vocabulary, cases, ids or None)
    found, impossible = missing_cases(loaded, make_engine("compiled", vocabulary), vocabulary, files)
    for rule in sorted({case.rule for case in found}):
        typer.echo(f"\n# for {rule}.yaml; `fires` is what the rule does now, check that it should")
        typer.echo("\n".join(str(case) for case in found if case.rule == rule), nl=False)
    for unmade in impossible:
        typer.echo(unmade)
    if not found and not impossible:
        typer.echo("the cases touch every limit")


def _engine_name(name: str) -> EngineName:
    if name == "compiled":
        return "compiled"
    if name == "experta":
        return "experta"
    typer.echo(f"unknown engine '{name}'; choose compiled or experta", err=True)
    raise typer.Exit(2)


@app.command()
def explain(name: Annotated[str, typer.Argument(metavar="ID", help="Id of the rule.")], rules: Layers = None) -> None:
    """Write one rule in plain English."""
    loaded = load(rules)
    known(loaded, name)
    rule = loaded.merged.rules[name][0]
    file, line = loaded.positions[name]
    typer.echo(f"{rule.id} {rule.name} ({file}:{line}, priority {rule.priority})")
    typer.echo(sentence(rule, words(), loaded.base.thresholds))
    typer.echo(f"References: {'; '.join(rule.references)}")


@app.command()
def show(
    rules: Layers = None,
    layers: Annotated[
        bool, typer.Option("--layers", help="Also say which file each rule, threshold and slot comes from.")
    ] = False,
    as_data: Annotated[bool, typer.Option("--json", help="Write the merged rule base as JSON.")] = False,
) -> None:
    """List the rules that are in force, by stage."""
    loaded = load(rules)
    if as_data:
        typer.echo(loaded.base.model_dump_json(by_alias=True, exclude_none=True, indent=2))
        return
    for stage in STAGES:
        for rule in loaded.base.of_stage(stage):
            where = f"  {written_in(loaded.merged, 'rules', rule.id)}" if layers else ""
            typer.echo(f"{rule.id}  {stage:<14}  {rule.name}{where}")
    if layers:
        for name, threshold in sorted(loaded.base.thresholds.items()):
            value = f"{threshold.value:g}" + (f" {threshold.unit}" if threshold.unit != "1" else "")
            typer.echo(f"threshold  {name} = {value}  {written_in(loaded.merged, 'thresholds', name)}")
        for (stage, slot), (item, _) in loaded.merged.slots.items():
            typer.echo(f"slot  {stage}.{slot} = {item.default}  {written_in(loaded.merged, 'slots', (stage, slot))}")
        for layer in loaded.merged.layers:
            for identifier, path in layer.disable:
                line = layer.document.mark(path)[0]
                typer.echo(f"{identifier}  disabled by {layer.document.file}:{line}")
    typer.echo(f"{len(loaded.base.rules)} rules, digest {loaded.digest}")


@app.command()
def schema() -> None:
    """Write the JSON Schema of the rule file, for editors."""
    typer.echo(json.dumps(json_schema(words(), operators(), probes()), indent=2, ensure_ascii=False))


app.command()(rule_writing.graph)
app.command()(rule_writing.new)
app.command()(rule_writing.fmt)
app.command()(rule_writing.pages)
app.command()(rule_diff.diff)
app.command()(rule_watch.watch)
