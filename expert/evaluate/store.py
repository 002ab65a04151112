"""The results of an evaluation: one SQLite file, written case by case, so that nothing that was run is lost."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

VERSION = 1


@dataclass(frozen=True)
class Row:
    """One system on one case.

    Attributes
    ----------
    case, pair, scene, variant : str
        `scene` groups the pairs that no split may separate.
    differs : bool
        Whether the pair differs radiometrically by itself.
    system, kind, digest : str
    bad_05, bad_1, bad_2, wrong, density : float
        %, see `Scores`.
    epe_px, cpu_s, wall_s : float
    peak_mb : float or None
        Memory beyond what the process held before, MB; None where the platform does not tell.
    failure : str or None
    rules : tuple of str
        Rules that fired.
    plan, findings : tuple of str
        What was done and found, for the regret list.
    """

    case: str
    pair: str
    scene: str
    variant: str
    differs: bool
    system: str
    kind: str
    digest: str
    bad_05: float
    bad_1: float
    bad_2: float
    wrong: float | None
    density: float
    epe_px: float | None
    cpu_s: float
    wall_s: float
    peak_mb: float | None = None
    failure: str | None = None
    rules: tuple[str, ...] = ()
    plan: tuple[str, ...] = ()
    findings: tuple[str, ...] = ()
    shares: dict[str, float] = field(default_factory=dict)  # share of the time of facts, inference and operators


COLUMNS = tuple(item.name for item in fields(Row))
JSON_COLUMNS = ("rules", "plan", "findings", "shares")


class StoreError(Exception):
    """A file that is no store of results, or of another version."""


class Store:
    """Results in a file.

    Parameters
    ----------
    path : Path
        Made if it is not there.

    Raises
    ------
    StoreError
        The file is something else.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with self._open() as base:
                found = base.execute("PRAGMA user_version").fetchone()[0]
                tables = base.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
                if found != VERSION and tables:
                    raise StoreError(f"{path} has version {found}, this program reads {VERSION}; give another file")
                base.execute("PRAGMA journal_mode = WAL")
                names = ", ".join(f'"{name}"' for name in COLUMNS)  # `case` is a word of SQL
                base.execute(f'CREATE TABLE IF NOT EXISTS runs ({names}, PRIMARY KEY ("case", system, digest))')
                base.execute(f"PRAGMA user_version = {VERSION}")
        except sqlite3.DatabaseError as error:
            raise StoreError(f"{path} is no SQLite file ({error}); give another file") from error

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        with closing(sqlite3.connect(self.path, timeout=60.0)) as base, base:
            yield base

    def add(self, rows: Iterable[Row]) -> None:
        """Write rows in one transaction; a row of the same case, system and digest is replaced."""
        marks = ", ".join("?" for _ in COLUMNS)
        with self._open() as base:
            base.executemany(f"INSERT OR REPLACE INTO runs VALUES ({marks})", [_stored(row) for row in rows])

    def done(self) -> set[tuple[str, str, str]]:
        """Return case, system and digest of everything that is there."""
        with self._open() as base:
            return {tuple(row) for row in base.execute('SELECT "case", system, digest FROM runs')}

    def last(self, system: str) -> tuple[Row, ...]:
        """Return the results of a system as it was run last, whatever its rules and versions were."""
        with self._open() as base:
            found = base.execute("SELECT digest FROM runs WHERE system = ? ORDER BY rowid DESC LIMIT 1", (system,))
            digest = found.fetchone()
        return () if digest is None else self.rows({system: str(digest[0])})

    def rows(self, digests: dict[str, str] | None = None) -> tuple[Row, ...]:
        """Return the results, or those of some systems, by digest."""
        with self._open() as base:
            found = [_read(row) for row in base.execute('SELECT * FROM runs ORDER BY "case", system')]
        if digests is None:
            return tuple(found)
        return tuple(row for row in found if digests.get(row.system) == row.digest)


def _stored(row: Row) -> tuple[object, ...]:
    data = asdict(row)
    return tuple(json.dumps(data[name]) if name in JSON_COLUMNS else data[name] for name in COLUMNS)


def _read(values: tuple[object, ...]) -> Row:
    data = dict(zip(COLUMNS, values, strict=True))
    for name in JSON_COLUMNS:
        value = json.loads(str(data[name]))
        data[name] = tuple(value) if isinstance(value, list) else value
    data["differs"] = bool(data["differs"])
    return Row(**data)  # type: ignore[arg-type]
