"""Output folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from modules.formats.errors import FormatError

MARK = ".terrex"  # says that a folder was written here and may be replaced


def check_folder(out: Path | str) -> None:
    """Check, before any work is done, that `whole_folder(out)` will be able to write.

    Raises
    ------
    FormatError
        When `out` is a file, holds files of somebody else, or its parent cannot be written.
    """
    target = Path(out).resolve()
    _check_replaceable(Path(out), target)
    parent = next(folder for folder in target.parents if folder.exists())
    if not os.access(parent, os.W_OK | os.X_OK):
        raise FormatError(f"{out} cannot be written ({parent} is read-only); choose a folder you may write to")


@contextmanager
def whole_folder(out: Path | str) -> Iterator[Path]:
    """Give a temporary sibling folder that takes the place of `out` when the block ends without an exception.

    A folder that was written this way before, or is empty, is replaced; its files survive a block that fails.

    Parameters
    ----------
    out : Path or str
        Folder to write.

    Yields
    ------
    Path
        Folder to write into.

    Raises
    ------
    FormatError
        When `out` is a file, holds files of somebody else, or cannot be written.
    """
    out = Path(out)
    # Resolved, so that `.` has a name and a link to a folder is written through.
    target = out.resolve()
    _check_replaceable(out, target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    except OSError as error:
        raise FormatError(f"{out} cannot be written ({error.strerror}); choose a folder you may write to") from error
    try:
        yield work
        try:
            (work / MARK).write_text("written by terrex; this folder may be replaced as a whole\n", encoding="utf-8")
            _replace(work, target, out)
        except OSError as error:
            raise FormatError(f"{out} cannot be written ({error.strerror}); choose another folder") from error
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _check_replaceable(out: Path, target: Path) -> None:
    if not target.exists():
        return
    if not target.is_dir():
        raise FormatError(f"{out} is a file and the results need a folder; choose another name")
    try:
        names = sorted(entry.name for entry in target.iterdir())
    except OSError as error:
        raise FormatError(f"{out} cannot be read ({error.strerror}); choose another folder") from error
    if names and MARK not in names:
        shown = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
        raise FormatError(
            f"{out} holds {len(names)} files that were not written by terrex ({shown}); "
            "choose a new or empty folder, nothing was changed"
        )


def _replace(work: Path, target: Path, out: Path) -> None:
    """Rename `work` to `target`; what was there is moved away first and put back if the rename fails."""
    mask = os.umask(0)
    os.umask(mask)
    work.chmod(0o777 & ~mask)  # mkdtemp makes folders that only their owner can read
    if not target.exists():
        work.rename(target)
        return
    _check_replaceable(out, target)
    old = Path(tempfile.mkdtemp(prefix=f".{target.name}.old.", dir=target.parent))
    try:
        target.rename(old / "folder")
        try:
            work.rename(target)
        except OSError:
            (old / "folder").rename(target)
            raise
    finally:
        if target.exists():
            shutil.rmtree(old, ignore_errors=True)
