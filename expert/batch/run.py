"""Run a batch: find out what is still to be done, do it, and lose nothing whatever happens."""

from __future__ import annotations

import shutil
import signal
import sqlite3
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from expert.batch.cluster import Transfer, run_on_cluster
from expert.batch.item import BatchItem
from expert.batch.local import Limits, run_here
from expert.batch.runlog import NAME, Latest, LogFull, RunLog
from expert.batch.work import PROCESSED, Outcome, Settings, inputs_digest, settings_digest, stamp, unprocessed
from expert.costs import measure_speed
from expert.versions import versions
from modules.formats.atomic import MARK
from modules.formats.errors import FormatError

Resume = Literal["ask", "redo", "keep"]
PAIRS = "pairs"  # folder of the products
CHANGED = "processed otherwise"
OTHER_INPUT = "input changed"
LOCK = "lock.sqlite"
SPEED = "machine speed"


class ChangedSettings(Exception):
    """Pairs were processed with other rules or versions, and nobody said what to do about it."""


@dataclass(frozen=True)
class Plan:
    """What a batch will do, and why.

    Attributes
    ----------
    todo : tuple of (BatchItem, str)
        Items to process, and why: `new`, `unfinished`, `input changed`, `processed otherwise`, `failed before`.
    done : int
        Items that need nothing.
    unprocessed : int
        Those of them that could not be processed and are not tried again.
    changes : tuple of str
        What is other than it was for the items that were processed with other rules, versions, profile, rover, budgets
        or products.
    """

    todo: tuple[tuple[BatchItem, str], ...]
    done: int
    changes: tuple[str, ...] = ()
    unprocessed: int = 0


@dataclass
class Progress:
    """How far a batch is."""

    total: int
    done: int = 0
    failed: int = 0
    not_processed: int = 0


class Batch:
    """A batch and its folder.

    Parameters
    ----------
    items : sequence of BatchItem
    out : Path
        Gets `run.sqlite` and `pairs/<name>/`.
    settings : Settings

    Raises
    ------
    FormatError
        The folder holds something else.
    expert.rules.problem.RuleFileError
        A rule file is wrong.
    """

    def __init__(self, items: Sequence[BatchItem], out: Path, settings: Settings, source: str = "") -> None:
        self.items = tuple(settings.complete(item) for item in items)
        _check_out(out)
        self.out, self.settings, self.source = out, _at_one_speed(settings, out / NAME), source
        self.versions = versions()
        self.record = self.settings.record(self.settings.system().rules_digest)
        self.digest = settings_digest(self.record, self.versions)

    def folder(self, item: BatchItem) -> Path:
        """Return the folder of an item's products."""
        return self.out / PAIRS / item.folder

    def plan(self, resume: Resume = "ask", *, retry: bool = False) -> Plan:
        """Compare the items with what the folder holds.

        Parameters
        ----------
        resume : {"ask", "redo", "keep"}
            What to do with pairs that were processed with other rules, versions, profile, rover, budgets or products.
        retry : bool
            Whether to try again the pairs that could not be processed.

        Raises
        ------
        ChangedSettings
            There are such pairs and `resume` is "ask"; the message counts them and says what is other.
        """
        log = RunLog(self.out / NAME) if (self.out / NAME).is_file() else None
        known = log.latest() if log is not None else {}
        todo: list[tuple[BatchItem, str]] = []
        before: set[int] = set()  # runs of the items that were processed otherwise
        changed = unprocessed = 0
        for item in self.items:
            latest = known.get(item.name)
            reason = self._reason(item, latest, retry)
            if reason == CHANGED and latest is not None:
                changed += 1
                before.add(latest.run)
            if reason and not (reason == CHANGED and resume == "keep"):
                todo.append((item, reason))
            elif latest is not None and latest.status not in PROCESSED:
                unprocessed += 1
        changes = self._changes(log, before) if log is not None else ()
        if changed and resume == "ask":
            raise ChangedSettings(
                f"{changed} of {len(self.items)} pairs in {self.out} were processed otherwise ({'; '.join(changes)}); "
                "say --resume redo to process them again, or --resume keep to leave them as they are"
            )
        return Plan(tuple(todo), len(self.items) - len(todo), changes, unprocessed)

    def _changes(self, log: RunLog, runs: Iterable[int]) -> tuple[str, ...]:
        """Say in what runs differ from this one."""
        found: dict[str, None] = {}
        for run in sorted(runs):
            settings, used = log.record(run)
            for name, now in {**self.record, **self.versions}.items():
                then = {**settings, **used}.get(name)
                if then != now and name != "python":
                    found[f"{name} {then}, now {now}"] = None
        return tuple(found)

    def _reason(self, item: BatchItem, latest: Latest | None, retry: bool) -> str:
        """Say why an item has to be processed; empty where it need not be."""
        if latest is None:
            return "new"
        if latest.stamp != stamp(item) and latest.inputs != inputs_digest(item):
            return OTHER_INPUT
        if latest.status not in PROCESSED:
            otherwise = latest.status != "unreadable" and latest.settings_digest != self.digest
            return "failed before" if retry or otherwise else ""
        if latest.settings_digest != self.digest:
            return CHANGED
        return "" if (self.folder(item) / "decision.json").is_file() else "unfinished"

    def run(
        self,
        plan: Plan,
        *,
        jobs: int = 1,
        limits: Limits | None = None,
        scheduler: str | None = None,
        transfer: Transfer = "path",
        progress: Callable[[Progress, Outcome], None] = lambda progress, outcome: None,
        interrupted: Callable[[], None] = lambda: None,
    ) -> Progress:
        """Process what a plan names; every result is committed as soon as it is there.

        SIGINT ends the batch after the pairs in work, a second one at once; both leave a folder that a later run goes
        on from.

        Parameters
        ----------
        plan : Plan
        jobs : int
            Worker processes on this machine.
        limits : Limits, optional
        scheduler : str, optional
            Address of a Dask scheduler; then `jobs` and `limits` do not matter.
        transfer : {"path", "bytes"}
        progress : callable
            Called after each pair.
        interrupted : callable
            Called at once when the first SIGINT comes.
        """
        limits = limits or Limits()
        with _interruptible(interrupted) as stopping:
            log = RunLog(self.out / NAME)
            with alone(self.out):
                return self._run(log, plan, jobs, limits, scheduler, transfer, progress, stopping)

    def _run(
        self,
        log: RunLog,
        plan: Plan,
        jobs: int,
        limits: Limits,
        scheduler: str | None,
        transfer: Transfer,
        progress: Callable[[Progress, Outcome], None],
        stopping: Callable[[], bool],
    ) -> Progress:
        self._clean()
        own = self.settings
        told = {**self.record, "engine": own.engine, "rule files": own.rules, SPEED: own.machine_speed}
        run = log.begin(self.source, told, self.digest, self.versions)
        state = Progress(len(plan.todo))
        items = ((item, self.folder(item)) for item, _ in plan.todo)
        reasons = {item.name: reason for item, reason in plan.todo}
        if scheduler is not None:
            results = run_on_cluster(items, self.settings, scheduler, transfer, stopping)
        else:
            results = run_here(items, self.settings, limits, jobs, stopping)
        for item, outcome in results:
            outcome = self._commit(log, run, item, outcome, reasons[item.name])
            state.done += 1
            state.failed += outcome.status == "failed"
            state.not_processed += outcome.status not in PROCESSED
            progress(state, outcome)
        log.end(run)
        return state

    def _commit(self, log: RunLog, run: int, item: BatchItem, outcome: Outcome, reason: str) -> Outcome:
        """Write the result of an item that was processed for a reason to the log and return it.

        Products of an earlier input do not stay beside a result that says that the present one failed.
        Where the products of a pair have filled the disk, so that the log has no room, they make room for it, and the
        result is that the disk was full.
        """
        if outcome.status not in PROCESSED and reason == OTHER_INPUT:
            shutil.rmtree(self.folder(item), ignore_errors=True)
        try:
            log.add(run, outcome, item.folder, self.digest)
        except LogFull:
            shutil.rmtree(self.folder(item), ignore_errors=True)
            full = "the products left no room on the disk for the log and were removed; make room and say --retry"
            outcome = unprocessed(item, "error", full, outcome.seconds)
            log.add(run, outcome, item.folder, self.digest)
        return outcome

    def _clean(self) -> None:
        """Remove what a killed run left unfinished: temporary folders of the products, never a finished one."""
        for path in (self.out / PAIRS).glob(".*"):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)


def _at_one_speed(settings: Settings, log: Path) -> Settings:
    """Return settings that state the speed of the machine, where costs are predicted: as a run before stated it."""
    if settings.time_budget_s is None or settings.machine_speed is not None:
        return settings
    before = RunLog(log).settings() if log.is_file() else []
    speeds = [told[SPEED] for told in before if isinstance(told.get(SPEED), float)]
    return replace(settings, machine_speed=float(str(speeds[-1])) if speeds else measure_speed())


def _check_out(out: Path) -> None:
    """Refuse a folder that holds files of somebody else."""
    if out.exists() and not out.is_dir():
        raise FormatError(f"{out} is a file and a batch needs a folder; choose another --out")
    if out.is_dir() and any(out.iterdir()) and not (out / NAME).is_file() and not (out / MARK).is_file():
        raise FormatError(f"{out} holds files that no batch wrote; choose a new or empty folder, nothing was changed")


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Keep other batches out of a folder; the lock goes with the process, however it ends.

    Raises
    ------
    FormatError
        Another batch is at work there.
    """
    with closing(sqlite3.connect(out / LOCK, timeout=0.0, isolation_level=None)) as base:
        try:
            base.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError as error:
            raise FormatError(f"another batch is at work in {out}; wait for it, or choose another --out") from error
        yield


@contextmanager
def _interruptible(interrupted: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Turn the first SIGINT into a wish to stop, and tell of it; the second one raises KeyboardInterrupt as usual."""
    stop = threading.Event()

    def handle(number: int, frame: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
        interrupted()

    if threading.current_thread() is not threading.main_thread():
        yield stop.is_set
        return
    before = signal.signal(signal.SIGINT, handle)
    try:
        yield stop.is_set
    finally:
        signal.signal(signal.SIGINT, before)
