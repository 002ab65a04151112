"""`terrex evaluate`: terrex and fixed configurations on pairs with truth, side by side."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import typer

from expert.cli.options import Profile
from expert.cli.usage import UsageError

if TYPE_CHECKING:
    from expert.evaluate import Case, ExpertConfiguration, FixedSystem, Row, Store
    from expert.evaluate.ablation import RuleEffect
    from expert.evaluate.systems import System

Data = Annotated[
    list[Path] | None,
    typer.Argument(help="Folders of pairs with truth: an INDEX.json, Middlebury v3, ETH3D or KITTI layout"),
]
Range = Literal["given", "estimated", "both"]
RESULTS = "results.sqlite"
PROFILES: tuple[Profile, ...] = get_args(Profile)


def evaluate(
    data: Data = None,
    split: Annotated[str | None, typer.Option(help="Only this split of an INDEX.json")] = None,
    rendered: Annotated[int, typer.Option(help="Number of rendered terrains to add")] = 0,
    first_seed: Annotated[int, typer.Option(help="Seed of the first rendered terrain; the others follow it")] = 0,
    every: Annotated[int, typer.Option(help="Take every N-th pair only")] = 1,
    variants: Annotated[
        str, typer.Option(help="Distortions, comma separated, with strengths: clean,noise:0.5; reference means all ten")
    ] = "reference",
    seeds: Annotated[int, typer.Option(help="Seeds of the noise per case")] = 1,
    profile: Annotated[list[str] | None, typer.Option(help="Profiles of terrex; all three if not given")] = None,
    range_: Annotated[Range, typer.Option("--range", help="Whether terrex is told the disparities to search")] = "both",
    rules: Annotated[list[Path] | None, typer.Option(help="Rule file layered on the shipped rules")] = None,
    candidate: Annotated[
        list[Path] | None,
        typer.Option(help="Rule file that is one choice among several; gives cross-validated numbers"),
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="Fixed configurations to run; all if not given, none for none")
    ] = None,
    pandora: Annotated[
        Path | None,
        typer.Option(metavar="PYTHON", help="Python of an environment with CNES Pandora and libsgm, for a peer"),
    ] = None,
    ablation: Annotated[
        list[str] | None, typer.Option(help="Rule to leave out where it fired; `all` for every rule")
    ] = None,
    compare: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="A B", help="Two rule files, or two folders of evaluations, compared pair by pair"),
    ] = None,
    jobs: Annotated[int, typer.Option(help="Worker processes")] = 1,
    out: Annotated[Path, typer.Option(help="Folder of the results; a second run goes on where the first ended")] = Path(
        "terrex-evaluation"
    ),
) -> None:
    """Measure terrex and a grid of fixed configurations on pairs with truth."""
    from expert.evaluate import PandoraSystem, Store, Table, fixed_grid
    from expert.evaluate.page import as_html
    from expert.evaluate.run import warm
    from expert.evaluate.summary import as_text, summarise
    from modules.formats._text import write_text

    if pandora is not None and not pandora.is_file():
        raise UsageError(f"--pandora {pandora} is not there; give the Python of an environment with Pandora")
    layers = tuple(str(path) for path in rules or [])
    own = _own(profile or PROFILES, range_, layers)
    base = next((item for item in own if item.profile == "balanced"), own[0])
    if compare is not None and all(path.is_dir() for path in compare):
        typer.echo(_compared_runs(compare, base.name), nl=False)
        return
    cases = _cases(data or [], split, range(first_seed, first_seed + rendered), every, variants, seeds)
    store = Store(out / RESULTS)
    if compare is not None:
        typer.echo(_compared_rules(compare, base, cases, store, jobs), nl=False)
        return
    left_out = _left_out(ablation or [], base)
    picked = _candidates(candidate or [], base)
    peers = [] if pandora is None else [PandoraSystem(pandora)]
    for peer in peers:
        warm(peer)  # a peer that cannot work ends the evaluation before it begins
    systems: list[System] = [*own, *picked, *_chosen(fixed_grid(), only), *peers]
    _run(cases, systems, store, jobs)
    table = Table.of(store.rows({system.name: system.digest() for system in systems}), [s.name for s in systems])
    if not len(table):
        raise UsageError("no pair has results of all the systems, so nothing can be compared; see what was left out")
    summary = summarise(table, [base.name, *(item.name for item in picked)] if picked else [])
    effects = _ablated(left_out, base, cases, store, jobs)
    write_text(out / "evaluation.html", as_html(summary, effects))
    typer.echo(as_text(summary), nl=False)
    if effects:
        from expert.evaluate.ablation import effects_text

        typer.echo("\n" + effects_text(effects), nl=False)
    typer.echo(f"\nwritten to {out / 'evaluation.html'}")


def _cases(
    data: Sequence[Path], split: str | None, rendered: range, every: int, variants: str, seeds: int
) -> tuple[Case, ...]:
    from expert.evaluate import RenderedTerrain, expand, parse_variants
    from modules.formats.datasets import list_pairs

    if not data and not rendered:
        raise UsageError("nothing to evaluate on: give folders of pairs with truth, or --rendered N")
    for name, value in (("--every", every), ("--seeds", seeds)):
        if value < 1:
            raise UsageError(f"{name} {value} is below 1; give 1 or more")
    sources = [entry for folder in data for entry in list_pairs(folder, split=split) if entry.truth is not None]
    if data and not sources:
        raise UsageError(f"no pair in {', '.join(map(str, data))} has a truth; give a data set with ground truth")
    try:
        distortions = parse_variants(part.strip() for part in variants.split(",") if part.strip())
    except ValueError as error:
        raise UsageError(str(error)) from error
    return expand([*sources[::every], *map(RenderedTerrain, rendered)], distortions, range(seeds))


def _own(profiles: Sequence[str], range_: Range, layers: tuple[str, ...]) -> list[ExpertConfiguration]:
    from expert.evaluate import ExpertConfiguration

    for name in profiles:
        if name not in PROFILES:
            raise UsageError(f"there is no profile {name!r}; known: {', '.join(PROFILES)}")
    found = []
    for profile in (name for name in PROFILES if name in profiles):
        if range_ in ("given", "both"):
            found.append(ExpertConfiguration(f"terrex {profile}", profile, layers))
        if range_ in ("estimated", "both"):
            found.append(ExpertConfiguration(f"terrex {profile}, range estimated", profile, layers, range="estimated"))
    return found


def _candidates(files: Sequence[Path], base: ExpertConfiguration) -> list[ExpertConfiguration]:
    return [replace(base, name=f"{base.name} with {path.stem}", rules=(*base.rules, str(path))) for path in files]


def _chosen(grid: Mapping[str, FixedSystem], only: Sequence[str] | None) -> list[FixedSystem]:
    from expert.rules.problem import suggest

    if not only:
        return list(grid.values())
    names = [name for name in only if name != "none"]
    for name in names:
        if name not in grid:
            hint = suggest(name, grid)
            raise UsageError(f"there is no fixed configuration {name!r}; {hint or 'known: ' + ', '.join(grid)}")
    return [grid[name] for name in names]


def _run(cases: Sequence[Case], systems: Sequence[System], store: Store, jobs: int) -> None:
    from expert.evaluate import evaluate as evaluate_all

    with _bar() as progress:
        report = evaluate_all(cases, systems, store, jobs=jobs, progress=progress)
    for problem in report.problems:
        typer.echo(f"left out: {problem}", err=True)
    typer.echo(f"{report.run} results new, {report.kept} kept from before", err=True)


def _compared_runs(folders: tuple[Path, Path], system: str) -> str:
    """Compare what two evaluations, by two versions perhaps, found for the same system."""
    from expert.evaluate import Store

    found: list[Row] = []
    for folder in folders:
        if not (folder / RESULTS).is_file():
            raise UsageError(f"{folder} holds no {RESULTS}; give the --out of an evaluation")
        rows = Store(folder / RESULTS).last(system)
        if not rows:
            raise UsageError(f"{folder} holds no result of {system!r}; say --profile and --range as it was run")
        found += [replace(row, system=str(folder)) for row in rows]
    return _difference(found, *map(str, folders))


def _compared_rules(
    files: tuple[Path, Path], base: ExpertConfiguration, cases: Sequence[Case], store: Store, jobs: int
) -> str:
    """Compare two rule files on the cases."""
    systems = _candidates(files, base)
    _run(cases, systems, store, jobs)
    return _difference(store.rows({system.name: system.digest() for system in systems}), *(s.name for s in systems))


def _difference(rows: Sequence[Row], a: str, b: str) -> str:
    from expert.evaluate import Table
    from expert.evaluate.compare import compare

    try:
        return compare(Table.of(rows, [a, b]), a, b).text()
    except ValueError as error:
        raise UsageError(str(error)) from error


def _left_out(wanted: Sequence[str], system: ExpertConfiguration) -> tuple[str, ...]:
    """Return the rules to leave out, one at a time; a name that is unknown is told before anything runs."""
    from expert.rules.problem import suggest

    known = system.system.rule_ids if wanted else ()
    for rule in wanted:
        if rule not in known and rule != "all":
            raise UsageError(f"there is no rule {rule!r}; {suggest(rule, known)}".rstrip("; "))
    return known if "all" in wanted else tuple(wanted)


def _ablated(
    rules: Sequence[str], system: ExpertConfiguration, cases: Sequence[Case], store: Store, jobs: int
) -> tuple[RuleEffect, ...]:
    from expert.evaluate.ablation import ablate

    if not rules:
        return ()
    with _bar() as progress:
        return ablate(system, rules, cases, store, jobs=jobs, progress=progress)


@contextmanager
def _bar() -> Iterator[Callable[[int, int], None]]:
    """Show the progress on a terminal; stay quiet in a pipe."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.progress import Progress

    with Progress() as bar:
        task = bar.add_task("cases", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
