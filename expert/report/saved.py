"""The report of a saved run, rendered again from its folder and from nothing outside it."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from expert.decision import Decision
from expert.report.answers import answer
from expert.report.html import as_html
from expert.report.markdown import as_markdown
from expert.report.pictures import FILES
from modules.formats.errors import FormatError


def read_run(folder: Path) -> tuple[Decision, dict[str, bytes]]:
    """Read the record and the files of a run that the report shows.

    Raises
    ------
    FormatError
        The folder holds no run, a file cannot be read, or a file is a link that leads out of the folder.
    """
    return read_decision(folder), {name: _content(folder, name) for name in FILES if (folder / name).is_file()}


def read_decision(folder: Path) -> Decision:
    """Read the record of a run.

    Raises
    ------
    FormatError
        As `read_run`.
    """
    if not (folder / "decision.json").is_file():
        raise FormatError(f"{folder} holds no decision.json; give the folder that `terrex run --out` wrote")
    try:
        return Decision.from_json(_content(folder, "decision.json").decode("utf-8"))
    except ValueError as error:
        raise FormatError(f"{folder / 'decision.json'}: {error}") from error


def _content(folder: Path, name: str) -> bytes:
    path = folder / name
    if path.resolve().parent != folder.resolve():
        raise FormatError(f"{path} is a link that leads out of the folder; copy the file itself there")
    try:
        return path.read_bytes()
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check its permissions") from error


def render_again(folder: Path) -> tuple[Path, Path]:
    """Write `report.html` and `report.md` of a saved run again; the same version gives the same bytes.

    Returns
    -------
    tuple of Path
        The HTML and the Markdown file.

    Raises
    ------
    FormatError
        As `read_run`, or the folder cannot be written.
    """
    decision, files = read_run(folder)
    answers = answer(decision)
    try:
        page = as_html(decision, files, answers)
    except ValueError as error:
        raise FormatError(f"{folder}: {error}") from error
    html, markdown = folder / "report.html", folder / "report.md"
    _replace(html, page)
    _replace(markdown, as_markdown(decision, answers, _names(folder)))
    return html, markdown


def _names(folder: Path) -> frozenset[str]:
    return frozenset(path.name for path in folder.iterdir())


def _replace(path: Path, text: str) -> None:
    """Write aside and rename, so that a reader never sees half a report."""
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        aside = Path(name)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(text.encode("utf-8"))
            mask = os.umask(0)
            os.umask(mask)
            aside.chmod(0o666 & ~mask)  # mkstemp makes files that only their owner can read
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)
    except OSError as error:
        raise FormatError(f"{path} cannot be written ({error.strerror}); choose a folder you may write to") from error
