"""`terrex`: run, decide, simulate and the rule tools.

Exit codes: 0 done; 1 done, and a pair could not be reconstructed or a rule is wrong; 2 wrong usage or unreadable input.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from expert.cli.options import BudgetOptions, PairOptions, PreviousOption, SystemOptions, expanded, read_previous
from expert.cli.terrain_options import DatumOption, MaskOption, ProductsOption, RoverOption
from expert.cli.usage import UsageError

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)


@contextmanager
def _progress() -> Iterator[Callable[[str], None] | None]:
    """Show what runs on a terminal; stay quiet in a pipe."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield status.update


@app.command()
@expanded
def run(
    pair: PairOptions,
    system: SystemOptions,
    budgets: BudgetOptions,
    out: Annotated[Path, typer.Option(help="Folder for the products; appears whole or not at all")] = Path(
        "terrex-out"
    ),
    products: ProductsOption = None,
    rover: RoverOption = None,
    datum: DatumOption = None,
    mask: MaskOption = None,
    previous: PreviousOption = None,
) -> None:
    """Reconstruct a stereo pair and write the products and the report."""
    from expert.cli.terrain_options import stated_datum, stated_products, stated_rover
    from expert.report import as_summary
    from modules.formats.atomic import check_folder

    check_folder(out)
    chosen, place, vehicle = stated_products(products), stated_datum(datum), stated_rover(rover)
    loaded = pair.load()
    seen = loaded if mask is None else loaded.without_masked(mask)
    earlier = read_previous(previous)
    expert = system.system(vehicle, budgets)
    with _progress() as progress:
        result = expert.reconstruct(seen, progress=progress, previous=earlier)
    before = _decision_of(out)
    result.save(out, products=chosen, datum=place)
    typer.echo(as_summary(result.decision), nl=False)
    typer.echo(
        f"\nall facts, rules and answers to 'why not?': report.html, or terrex report --text {out}\nwritten to {out}"
        + ("" if before in (None, result.decision.id) else f", in the place of decision {before}")
    )
    if not result.reconstructed:
        raise typer.Exit(1)


def _decision_of(out: Path) -> str | None:
    """Return the id of the decision whose results a folder holds; None where it holds none that can be read."""
    from expert.decision import Decision

    try:
        return Decision.from_json((out / "decision.json").read_text(encoding="utf-8")).id
    except (OSError, ValueError):
        return None


@app.command()
@expanded
def decide(
    pair: PairOptions,
    system: SystemOptions,
    budgets: BudgetOptions,
    json: Annotated[bool, typer.Option("--json", help="Print the whole record")] = False,
    full: Annotated[
        bool, typer.Option("--full", help="Also print facts, what lost and why, and every rule that fired")
    ] = False,
    previous: PreviousOption = None,
) -> None:
    """Measure a pair and print what would be done and why; nothing is matched."""
    from expert.report import as_outline

    loaded, earlier = pair.load(), read_previous(previous)
    expert = system.system(budgets=budgets)
    with _progress() as progress:
        decision = expert.decide(loaded, progress=progress, previous=earlier)
    typer.echo(decision.to_json() if json else decision.text() if full else as_outline(decision), nl=False)
    if not (json or full):
        typer.echo("\n--full also prints facts, what lost and why, and what each rule says; --json prints the record")
    if decision.status == "failed":
        raise typer.Exit(1)


@app.command()
def simulate(
    out: Annotated[Path, typer.Option(help="Folder for the pair and its truth")],
    seed: Annotated[int, typer.Option(help="The same seed gives the same pair")] = 0,
    roll: Annotated[float, typer.Option(help="degrees")] = 0.0,
    pitch: Annotated[float, typer.Option(help="degrees, positive lowers the nose")] = 0.0,
    yaw: Annotated[float, typer.Option(help="degrees")] = 0.0,
    distortion: Annotated[str, typer.Option(help="Reference distortion of the right camera")] = "clean",
) -> None:
    """Render a rough-terrain pair with its exact truth."""
    from pydantic import ValidationError

    from modules.formats.simulation import write_rendered_pair
    from modules.simulation import REFERENCE_DISTORTIONS, TerrainParams, distort_right, render_terrain
    from modules.types import Views

    if distortion not in REFERENCE_DISTORTIONS:
        raise UsageError(f"there is no distortion {distortion!r}; known: {', '.join(REFERENCE_DISTORTIONS)}")
    try:
        params = TerrainParams(seed=seed, roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw)
    except ValidationError as error:
        wrong = [
            f"--{str(item['loc'][0]).removesuffix('_deg')} {item['input']}: {item['msg']}" for item in error.errors()
        ]
        raise UsageError("; ".join(wrong)) from error
    with _progress() as progress:
        if progress:
            progress("rendering")
        rendered = render_terrain(params)
    views = distort_right(Views(rendered.left, rendered.right), distortion, seed=seed)
    write_rendered_pair(
        out,
        views,
        rendered.calibration,
        rendered.mount,
        rendered.attitude,
        rendered.disparity_px,
        rendered.occluded,
        rendered.elevation,
    )
    typer.echo(f"written to {out}")


def complete_app() -> typer.Typer:
    """Return the application with the commands of all files; they are imported only here, so that `run` starts fast."""
    from expert.cli.batch import batch
    from expert.cli.calibrate import calibrate
    from expert.cli.evaluate import evaluate
    from expert.cli.explain import explain
    from expert.cli.fuse import fuse
    from expert.cli.log import log
    from expert.cli.replay import replay_command
    from expert.cli.report import report
    from expert.cli.rules import app as rules_app

    if not any(group.name == "rules" for group in app.registered_groups):
        app.command()(batch)
        app.command()(log)
        app.command()(evaluate)
        app.command()(calibrate)
        app.command()(explain)
        app.command()(fuse)
        app.command("replay")(replay_command)
        app.command()(report)
        app.add_typer(rules_app, name="rules", help="Check, test and explain rule files")
    return app


def run_command() -> None:
    """Run the command that the arguments name; faults of the input end with exit code 2 and a sentence.

    Raises
    ------
    KeyboardInterrupt
        SIGINT ended the command.
    """
    from expert.cli import INTERRUPTED
    from expert.firing import RunawayRuleBase
    from expert.pair import PairError
    from expert.plan import PlanError
    from expert.rules.problem import RuleFileError
    from modules.formats import FormatError

    try:
        complete_app()()
    except (FormatError, PairError, PlanError, RuleFileError, RunawayRuleBase, UsageError) as error:
        typer.echo(str(error), err=True)
        sys.exit(2)
    except SystemExit as end:
        if end.code == INTERRUPTED:  # typer turns the interrupt into this
            raise KeyboardInterrupt from end
        raise
