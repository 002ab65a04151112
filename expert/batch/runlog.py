"""The log of a batch: one SQLite file, a row per result, committed as soon as its products stand in their folder."""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from expert.batch.work import PROCESSED, Outcome
from modules.formats.errors import FormatError

VERSION = 1
NAME = "run.sqlite"
SCHEMA = """
CREATE TABLE runs (
    run INTEGER PRIMARY KEY, started TEXT, ended TEXT, source TEXT, settings TEXT, settings_digest TEXT, versions TEXT);
CREATE TABLE results (
    result INTEGER PRIMARY KEY, run INTEGER REFERENCES runs, pair TEXT, folder TEXT, status TEXT, reason TEXT,
    inputs TEXT, stamp TEXT, settings_digest TEXT, decision_id TEXT, score REAL, seconds REAL, cpu_s REAL,
    finished TEXT, latest INTEGER);
CREATE UNIQUE INDEX one_latest ON results (pair) WHERE latest = 1;
CREATE TABLE firings (result INTEGER REFERENCES results, rule TEXT, stage TEXT);
CREATE INDEX firings_by_rule ON firings (rule, result);
CREATE TABLE findings (result INTEGER REFERENCES results, finding TEXT, severity TEXT);
CREATE TABLE steps (result INTEGER REFERENCES results, slot TEXT, operator TEXT, rule TEXT);
CREATE TABLE facts (result INTEGER REFERENCES results, fact TEXT, value REAL);
"""


class LogFull(FormatError):
    """The log cannot be written; the disk is full, as far as SQLite tells."""


@dataclass(frozen=True)
class Latest:
    """The last result of a pair, as far as a later run needs it."""

    status: str
    inputs: str
    stamp: str
    settings_digest: str
    run: int


def now() -> str:
    """Return the time as ISO 8601 in UTC."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


class RunLog:
    """The log in a folder.

    Parameters
    ----------
    path : Path
        `run.sqlite`; made if it is not there.
    read_only : bool
        Refuse a file that is not there instead; then the folder need not be writable.

    Raises
    ------
    FormatError
        The file is something else, of another version, or cannot be opened.
    """

    def __init__(self, path: Path, *, read_only: bool = False) -> None:
        self.path = path
        self._immutable = False
        if read_only:
            self._check_readable()
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        with self._writing() as base:
            empty = not base.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
            if empty:
                base.execute("PRAGMA journal_mode = WAL")
                base.executescript(f"BEGIN; {SCHEMA} PRAGMA user_version = {VERSION}; COMMIT;")
            else:
                self._check_version(base)

    def _check_readable(self) -> None:
        """Find a way to read the log; where nothing can be written beside it, it is read as it is."""
        if not self.path.is_file():
            raise FormatError(f"{self.path} is not there; give the folder that `terrex batch --out` wrote")
        for self._immutable in (False, True):
            try:
                with self._open() as base:
                    self._check_version(base)
                return
            except sqlite3.OperationalError as error:
                if self._immutable or self.path.with_name(f"{NAME}-wal").exists():
                    raise FormatError(f"{self.path} cannot be read ({error})") from error
            except sqlite3.DatabaseError as error:
                raise FormatError(f"{self.path} is no log of a batch ({error}); choose another folder") from error

    def _check_version(self, base: sqlite3.Connection) -> None:
        version = base.execute("PRAGMA user_version").fetchone()[0]
        if version != VERSION:
            raise FormatError(f"{self.path} has version {version}, this program reads {VERSION}; choose another folder")

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        place = f"{self.path.absolute().as_uri()}{'?immutable=1' if self._immutable else ''}"
        with closing(sqlite3.connect(place, timeout=60.0, uri=True)) as base, base:
            yield base

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """Open the log to write to it.

        Raises
        ------
        LogFull
            The disk is full.
        FormatError
            It cannot be written for another reason, or is something else.
        """
        try:
            with self._open() as base:
                yield base
        except sqlite3.OperationalError as error:
            # Python 3.10 knows no codes of these errors; a log whose shared part cannot grow fails with an I/O error.
            if not any(word in str(error) for word in ("full", "disk I/O")):
                raise FormatError(
                    f"{self.path} cannot be written ({error}); nothing that was finished is lost"
                ) from error
            raise LogFull(
                f"{self.path} cannot be written ({error}); make room on the disk and give the same command again: "
                "what was finished is kept"
            ) from error
        except sqlite3.DatabaseError as error:
            raise FormatError(f"{self.path} is no log of a batch ({error}); choose another folder") from error

    def begin(self, source: str, settings: Mapping[str, object], digest: str, versions: Mapping[str, str]) -> int:
        """Note that a run begins; return its number."""
        with self._writing() as base:
            cursor = base.execute(
                "INSERT INTO runs (started, source, settings, settings_digest, versions) VALUES (?, ?, ?, ?, ?)",
                (now(), source, json.dumps(settings), digest, json.dumps(versions)),
            )
            return int(cursor.lastrowid or 0)

    def end(self, run: int) -> None:
        """Note that a run ended."""
        with self._writing() as base:
            base.execute("UPDATE runs SET ended = ? WHERE run = ?", (now(), run))

    def latest(self) -> dict[str, Latest]:
        """Return the last result of every pair."""
        with self._open() as base:
            found = base.execute(
                "SELECT pair, status, inputs, stamp, settings_digest, run FROM results WHERE latest = 1"
            )
            return {str(pair): Latest(*rest) for pair, *rest in found}

    def settings(self) -> list[dict[str, object]]:
        """Return the settings of all runs, the first one first."""
        with self._open() as base:
            return [json.loads(text) for (text,) in base.execute("SELECT settings FROM runs ORDER BY run")]

    def record(self, run: int) -> tuple[dict[str, object], dict[str, str]]:
        """Return the settings and the versions of a run."""
        with self._open() as base:
            settings, versions = base.execute("SELECT settings, versions FROM runs WHERE run = ?", (run,)).fetchone()
        return json.loads(settings), json.loads(versions)

    def add(self, run: int, outcome: Outcome, folder: str, settings_digest: str) -> None:
        """Commit a result with its firings, findings, steps and facts, all or nothing."""
        with self._writing() as base:
            base.execute("UPDATE results SET latest = 0 WHERE pair = ? AND latest = 1", (outcome.name,))
            cursor = base.execute(
                "INSERT INTO results (run, pair, folder, status, reason, inputs, stamp, settings_digest, decision_id, "
                "score, seconds, cpu_s, finished, latest) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, 1)",
                (
                    run,
                    outcome.name,
                    folder if outcome.status in PROCESSED else "",
                    outcome.status,
                    outcome.reason,
                    outcome.inputs,
                    outcome.stamp,
                    settings_digest,
                    outcome.decision_id,
                    outcome.score,
                    outcome.seconds,
                    outcome.cpu_s,
                    now(),
                ),
            )
            result = int(cursor.lastrowid or 0)
            for table, rows in _parts(outcome.decision).items():
                for row in rows:
                    base.execute(f"INSERT INTO {table} VALUES (?{', ?' * len(row)})", (result, *row))

    def query(self, text: str, values: Iterable[object] = ()) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
        """Run a query that cannot change the log; return the columns and the rows.

        Raises
        ------
        FormatError
            The query is wrong, or would write.
        """
        try:
            with self._open() as base:
                base.execute("PRAGMA query_only = ON")
                cursor = base.execute(text, tuple(values))
                names = tuple(item[0] for item in cursor.description or ())
                return names, cursor.fetchall()
        except sqlite3.Error as error:
            raise FormatError(f"the query failed: {error}") from error


def _parts(decision: str) -> dict[str, set[tuple[object, ...]]]:
    """Take apart what of a decision can be asked for."""
    if not decision:
        return {}
    data = json.loads(decision)
    facts: set[tuple[object, ...]] = set()
    for record in data["facts"]:
        words = [str(value) for value in record["fields"].values() if isinstance(value, str)]
        name = record["template"] + (f"[{', '.join(words)}]" if words else "")
        for field, value in record["fields"].items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                facts.add((f"{name}.{field}", float(value)))
    return {
        "firings": {(item["rule"], item["stage"]) for item in data["firings"]},
        "findings": {(item["name"], item["severity"]) for item in data["findings"]},
        "steps": {
            (f"{stage}.{step['slot']}", step["operator"], step["chosen_by"] or "default")
            for stage, plan in data["plans"].items()
            for step in plan["steps"]
        },
        "facts": facts,
    }
