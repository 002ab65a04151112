"""`terrex calibrate`: a stereo camera from pairs of images of a chessboard."""

from __future__ import annotations

import json
from collections import Counter
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from expert.cli.usage import UsageError

if TYPE_CHECKING:
    from modules.formats.pairs import PairFiles
    from modules.rectification.calibrate import RigCalibration
    from modules.rectification.chessboard import BoardView, Chessboard

GOOD_EPIPOLAR_PX = 0.5  # rows of a rectified pair that differ by more cost matches
LEAST_COVERAGE = 0.5  # of the cells; boards have to be whole in both images, so all of one is hardly ever reached
LARGEST_SIGMA = 0.01  # of the focal length
BETTER = 0.5  # times the error of a lens model, or less, is that of a better one
SHOWN = 2  # rectified pairs in the picture
LOOKED_AT = 10  # images in which a board of another size is looked for


class Lens(str, Enum):
    """Lens model of both cameras."""

    radtan = "radtan"
    fisheye = "fisheye"


MODELS: dict[Lens, Literal["radtan", "equidistant"]] = {Lens.radtan: "radtan", Lens.fisheye: "equidistant"}


def calibrate(
    folder: Annotated[Path | None, typer.Argument(help="Folder with left01.png, right01.png and so on")] = None,
    pattern: Annotated[str, typer.Option(help="Inner corners of the board, columns x rows")] = "9x6",
    square: Annotated[float, typer.Option(help="Side of a square, m; the baseline scales with it")] = 0.025,
    model: Annotated[
        Lens,
        typer.Option(help="Lenses: radtan (Brown, up to about 100 degrees of view) or fisheye (Kannala and Brandt)"),
    ] = Lens.radtan,
    out: Annotated[Path, typer.Option(help="Folder for calibration.yaml and the picture; whole or not at all")] = Path(
        "calibration"
    ),
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema of calibration.yaml")] = False,
) -> None:
    """Calibrate a stereo camera from pairs of images of a chessboard.

    Exit code 1 says that the calibration was written and should not be trusted as it is.
    """
    from modules.formats.atomic import check_folder, whole_folder
    from modules.formats.calibration import calibration_schema, write_calibration
    from modules.formats.images import read_image, write_image
    from modules.formats.pairs import find_pairs
    from modules.rectification.calibrate import MIN_VIEWS, CalibrationFailed, calibrate_rig
    from modules.rectification.picture import draw_calibration

    if schema:
        typer.echo(json.dumps(calibration_schema(), indent=2))
        return
    if folder is None:
        raise UsageError("give the folder that holds the images of the chessboard, or --schema")
    board = _board(pattern, square)
    check_folder(out)
    pairs, lonely = find_pairs(folder)
    for path in lonely:
        typer.echo(f"{path} has no image of the other side and is left out", err=True)
    views, size = _views(pairs, board)
    try:
        made = calibrate_rig(views, board, size, MODELS[model])
    except CalibrationFailed as error:
        hint = _other_board(pairs, board) if len(views) < MIN_VIEWS else _other_lens(views, board, size, model, None)
        raise UsageError(f"{folder}: {error}{hint and '. ' + hint}") from error
    by_name = {pair.name: pair for pair in pairs}
    with whole_folder(out) as target:
        write_calibration(target / "calibration.yaml", made.rig)
        (target / "errors.json").write_text(_record(made, board, square), encoding="utf-8")
        shown = [
            (caption, read_image(by_name[name].left), read_image(by_name[name].right)) for caption, name in _shown(made)
        ]
        write_image(target / "calibration.png", draw_calibration(made, views, shown))
    warnings = _warnings(made)
    if hint := _other_lens(views, board, size, model, made):
        warnings.append(hint)
    typer.echo(_summary(made, len(pairs), pattern, square))
    for note in _notes(made):
        typer.echo(f"note: {note}")
    for warning in warnings:
        typer.echo(f"warning: {warning}")
    typer.echo(f"written to {out}; use it with --calibration {out / 'calibration.yaml'}")
    if warnings:
        raise typer.Exit(1)


def _board(pattern: str, square_m: float) -> Chessboard:
    from modules.rectification.chessboard import Chessboard

    columns, _, rows = pattern.lower().partition("x")
    if not (columns.isdigit() and rows.isdigit() and min(int(columns), int(rows)) >= 3):
        raise UsageError(f"--pattern is {pattern!r} and must be like 9x6: inner corners, 3x3 at least")
    if not 0.001 <= square_m <= 2.0:
        raise UsageError(f"--square is {square_m:g} m and must lie between 0.001 and 2 m; is it in mm? divide by 1000")
    return Chessboard(int(columns), int(rows), square_m)


def _views(pairs: list[PairFiles], board: Chessboard) -> tuple[list[BoardView], tuple[int, int]]:
    """Find the board in every pair; say where it is not seen."""
    from modules.formats.images import read_image
    from modules.rectification.chessboard import find_board

    views: list[tuple[tuple[int, int], BoardView]] = []
    for pair in pairs:
        left, right = read_image(pair.left), read_image(pair.right)
        size = (left.shape[1], left.shape[0])
        view = None
        if left.shape[:2] == right.shape[:2]:
            view = find_board(pair.name, left, right, board)
        if view is None:
            typer.echo(f"{pair.name}: no whole board of {board.columns}x{board.rows} inner corners in both images")
        else:
            views.append((size, view))
    sizes = Counter(size for size, _ in views)
    chosen = max(sizes, key=lambda size: sizes[size], default=(0, 0))
    for size, view in views:
        if size != chosen:
            typer.echo(f"{view.name}: {size[0]}x{size[1]} px, where most pairs have {chosen[0]}x{chosen[1]}; left out")
    return [view for size, view in views if size == chosen], chosen


def _other_board(pairs: list[PairFiles], board: Chessboard) -> str:
    """Say which board the images show, where it is another one; empty if not."""
    from modules.formats.images import read_image
    from modules.rectification.chessboard import count_corners

    found = count_corners(read_image(pair.left) for pair in pairs[:LOOKED_AT])
    if found is None or set(found) == {board.columns, board.rows}:
        return ""
    return (
        f"The images seem to show a board of {found[0]}x{found[1]} inner corners; try --pattern {found[0]}x{found[1]}"
    )


def _other_lens(
    views: list[BoardView], board: Chessboard, size: tuple[int, int], model: Lens, made: RigCalibration | None
) -> str:
    """Say that the other lens model fits much better, or at all; empty if not."""
    from modules.rectification.calibrate import CalibrationFailed, calibrate_rig

    def error(of: RigCalibration) -> float:
        return max(of.total("reprojection_px"), of.total("epipolar_px"))

    other = Lens.fisheye if model is Lens.radtan else Lens.radtan
    try:
        tried = calibrate_rig(views, board, size, MODELS[other])
    except CalibrationFailed:
        return ""
    limit = GOOD_EPIPOLAR_PX if made is None else BETTER * error(made)
    if error(tried) > limit:
        return ""
    before = "" if made is None else f" instead of {error(made):.2f} px"
    return f"the lens model {other.value} leaves {error(tried):.2f} px{before}; use --model {other.value}"


def _notes(made: RigCalibration) -> list[str]:
    """Say where the calibration is extrapolated, which no error shows."""
    blind = [
        f"the {' and '.join(', '.join(places).rsplit(', ', 1))} of the {side} image"
        for side, places in zip(("left", "right"), made.blind, strict=True)
        if places
    ]
    if not blind:
        return []
    return [f"the board was never seen in {' and '.join(blind)}: the distortion there is extrapolated"]


def _shown(made: RigCalibration) -> list[tuple[str, str]]:
    """Return captions and names of the best and the worst view that were used."""
    used = sorted((error for error in made.errors if error.used), key=lambda error: error.epipolar_px)
    chosen = [used[0], used[-1]][: min(SHOWN, len(used))]
    return [
        (f"{what}: pair {error.name}, rectified; rows differ by {error.epipolar_px:.2f} px", error.name)
        for what, error in zip(("best", "worst used"), chosen, strict=False)
    ]


def _record(made: RigCalibration, board: Chessboard, square_m: float) -> str:
    """Return the errors as JSON."""
    views = [
        {
            "pair": error.name,
            "reprojection_px": round(error.reprojection_px, 4),
            "epipolar_px": round(error.epipolar_px, 4),
            "used": error.used,
        }
        for error in made.errors
    ]
    record = {
        "model": made.rig.left.model,
        "pattern": [board.columns, board.rows],
        "square_m": square_m,
        "reprojection_px": round(made.total("reprojection_px"), 4),
        "epipolar_px": round(made.total("epipolar_px"), 4),
        "sigma_focal_px": [round(value, 3) for value in made.sigma_focal_px],
        "coverage": list(made.coverage),
        "not_covered": {"left": list(made.blind[0]), "right": list(made.blind[1])},
        "views": views,
    }
    return json.dumps(record, indent=2) + "\n"


def _summary(made: RigCalibration, pairs: int, pattern: str, square_m: float) -> str:
    rig = made.rig
    lines = ["pair        reprojection px  epipolar px"]
    for error in made.errors:
        note = "" if error.used else "   dropped: it does not agree with the others"
        lines.append(f"{error.name:12s}{error.reprojection_px:15.2f}{error.epipolar_px:13.2f}{note}")
    used = sum(error.used for error in made.errors)
    baseline = sum(value**2 for value in rig.translation_m) ** 0.5
    lines += [
        f"{'all used':12s}{made.total('reprojection_px'):15.2f}{made.total('epipolar_px'):13.2f}",
        f"{used} of {pairs} pairs used; board {pattern}, squares of {square_m:g} m",
        f"left  f {rig.left.focal_px[0]:.2f} +- {made.sigma_focal_px[0]:.2f} px, right f {rig.right.focal_px[0]:.2f} "
        f"+- {made.sigma_focal_px[1]:.2f} px",
        f"baseline {baseline:.5f} m",
    ]
    return "\n".join(lines)


def _warnings(made: RigCalibration) -> list[str]:
    said = []
    if made.total("epipolar_px") > GOOD_EPIPOLAR_PX:
        said.append(
            f"rows of rectified pairs differ by {made.total('epipolar_px'):.2f} px, above {GOOD_EPIPOLAR_PX:g} px; "
            "hold the board still, keep both cameras in step, and take the pairs again"
        )
    for side, fraction in zip(("left", "right"), made.coverage, strict=True):
        if fraction < LEAST_COVERAGE:
            said.append(
                f"corners cover {fraction:.0%} of the {side} image, below {LEAST_COVERAGE:.0%}; "
                "move the board into the corners of the image, where the distortion is largest"
            )
    for side, camera, sigma in zip(
        ("left", "right"), (made.rig.left, made.rig.right), made.sigma_focal_px, strict=True
    ):
        if sigma > LARGEST_SIGMA * camera.focal_px[0]:
            said.append(
                f"the focal length of the {side} camera is uncertain by {sigma:.1f} px "
                f"({sigma / camera.focal_px[0]:.1%}); tilt the board by 30 to 45 degrees in some of the pairs"
            )
    return said
