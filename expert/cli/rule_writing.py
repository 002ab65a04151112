"""Commands of `terrex rules` for those who write rules: graph, pages, new and fmt."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path
from typing import Annotated, Literal, NoReturn, Optional

import typer

from expert.cli.rule_common import Layers, exit_code, is_shipped, known, load, words
from expert.rules.cases import case_directory, read_cases
from expert.rules.drawing import as_svg
from expert.rules.graph import as_mermaid, rule_graph
from expert.rules.load import LoadedRules
from expert.rules.model import Stage
from expert.rules.pages import Reference
from expert.rules.pages import pages as reference_pages
from expert.rules.problem import RuleFileError
from expert.rules.skeleton import NEW_FILE, appended, cases_skeleton, next_id, rule_skeleton
from expert.rules.style import format_rules
from modules.catalog import operators, probes


def graph(
    ids: Annotated[Optional[list[str]], typer.Argument(help="Rule ids; all rules without any.")] = None,  # noqa: UP045
    rules: Layers = None,
    stage: Annotated[Optional[Stage], typer.Option("--stage", help="Only the rules of one stage.")] = None,  # noqa: UP045
    form: Annotated[Literal["mermaid", "svg"], typer.Option("--format", help="How to draw it.")] = "mermaid",
    out: Annotated[Optional[Path], typer.Option("--out", help="File to write; `.svg` draws SVG.")] = None,  # noqa: UP045
) -> None:
    """Draw rules with the facts and findings they read, and the findings, slots and probes they write."""
    loaded = load(rules)
    for name in ids or []:
        known(loaded, name)
    chosen = [
        rule.id for rule in loaded.base.rules if (not ids or rule.id in ids) and (not stage or rule.stage == stage)
    ]
    if form == "svg" or (out is not None and out.suffix == ".svg"):
        text = as_svg(loaded.base, words(), operators(), probes(), chosen)
    else:
        text = as_mermaid(rule_graph(loaded.base, operators(), probes(), chosen))
    if out is None:
        typer.echo(text, nl=False)
    else:
        _replace(out, text)
        typer.echo(f"written to {out}")


def pages(
    out: Annotated[Path, typer.Option("--out", help="Folder for the pages; pages of an earlier run are replaced.")],
    rules: Layers = None,
    cases: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--cases", help="Directory of the case files."),
    ] = None,
) -> None:
    """Write reference pages in Markdown: rules, facts, operators, thresholds, findings, slots and check codes."""
    loaded, vocabulary = load(rules), words()
    files, problems = read_cases(loaded.merged, vocabulary, cases)
    if problems:
        _refuse("\n".join(str(problem) for problem in problems), 1)
    made = reference_pages(Reference(loaded, files, vocabulary, operators(), probes()))
    for folder in ("rules", "checks"):
        for old in (out / folder).glob("*.md") if (out / folder).is_dir() else []:
            if f"{folder}/{old.name}" not in made:
                old.unlink()
    for path, text in made.items():
        _replace(out / path, text)
    typer.echo(f"{len(made)} pages written to {out}; begin with {out / 'README.md'}")


def new(
    stage: Annotated[Stage, typer.Argument(help="Stage of the rule.")],
    name: Annotated[str, typer.Argument(help="What the rule is about: the condition, in words joined by hyphens.")],
    rules: Layers = None,
    write: Annotated[Optional[Path], typer.Option("--write", help="Append the rule to this file.")] = None,  # noqa: UP045
    cases: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--cases", help="Write the case file into this directory."),
    ] = None,
) -> None:
    """Print the beginning of a new rule, with the next free id, and of its case file."""
    if not re.fullmatch("[a-z][a-z0-9-]*", name):
        _refuse(f"{name!r} is not a name; write small letters, digits and hyphens, e.g. exposure-differs-globally", 2)
    layers = [*(rules or []), *([write] if write and write.exists() and write not in (rules or []) else [])]
    loaded = load([path for path in layers if not is_shipped(path)])
    same = [rule.id for rule in loaded.base.rules if rule.name == name]
    if same:
        _refuse(f"{same[0]} has the name {name} already; choose another", 2)
    try:
        identifier = next_id(stage, _used_ids(loaded, cases))
    except ValueError as error:
        _refuse(str(error), 1)
    skeleton = rule_skeleton(identifier, stage, name, operators(), probes())
    case_file = cases / f"{identifier}.yaml" if cases else None
    if write is not None:
        _append(write, skeleton)
        typer.echo(f"{identifier} is in {write}; write when, then, because and references, then: terrex rules check")
    else:
        typer.echo("".join(f"  {line}" for line in skeleton.splitlines(keepends=True)), nl=False)
    if case_file is not None:
        _replace(case_file, cases_skeleton())
        typer.echo(f"its cases are in {case_file}")
    else:
        typer.echo(f"\n# knowledge/cases/{identifier}.yaml\n{cases_skeleton()}", nl=False)


def _used_ids(loaded: LoadedRules, cases: Path | None) -> set[str]:
    """Return every id that rules in force, disabled rules or case files bear."""
    folders = [case_directory(), *([cases] if cases else [])]
    return {*loaded.merged.rules, *loaded.merged.disabled, *(path.stem for item in folders for path in item.glob("*"))}


def _append(file: Path, skeleton: str) -> None:
    raw = file.read_bytes() if file.exists() else NEW_FILE.encode()
    try:
        text = appended(str(file), raw, skeleton)
    except RuleFileError as error:
        _refuse(str(error), exit_code(error))
    _replace(file, text)


def fmt(
    files: Annotated[list[Path], typer.Argument(help="Rule files or case files.")],
    check: Annotated[bool, typer.Option("--check", help="Only say which files would change.")] = False,
) -> None:
    """Lay out files alike; comments, order and meaning stay."""
    code = 0
    for path in files:
        try:
            raw = path.read_bytes()
            text = format_rules(str(path), raw)
        except OSError as error:
            typer.echo(f"{path}: cannot read the file: {error.strerror}", err=True)
            code = 2
            continue
        except RuleFileError as error:
            typer.echo(str(error), err=True)
            code = max(code, 1)
            continue
        if text.encode() == raw:
            continue
        if check:
            typer.echo(f"{path} is not laid out; run terrex rules fmt {path}")
            code = max(code, 1)
        else:
            _replace(path, text)
            typer.echo(f"laid out {path}")
    if code:
        raise typer.Exit(code)


def _replace(path: Path, text: str) -> None:
    """Write a file so that it is the old or the new one at any moment, with the rights of the old one."""
    target = path.resolve()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    except OSError as error:
        _refuse(f"cannot write {path}: {error.strerror}", 2)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(text.encode())
        if target.exists():
            shutil.copymode(target, name)
        else:
            os.chmod(name, 0o644)
        os.replace(name, target)
    except OSError as error:
        Path(name).unlink(missing_ok=True)
        _refuse(f"cannot write {path}: {error.strerror}", 2)


def _refuse(sentence: str, code: int) -> NoReturn:
    typer.echo(sentence, err=True)
    raise typer.Exit(code)
