"""Run systems on cases: in parallel over the cases, resumable, every result written as soon as it is there."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from expert.decision import Decision
from expert.evaluate.cases import Case
from expert.evaluate.scores import score
from expert.evaluate.store import Row, Store
from expert.evaluate.systems import System
from modules.formats.datasets import DatasetPair
from modules.primitives.threads import serial_linear_algebra
from modules.types import Views


@dataclass(frozen=True)
class Work:
    """The cases of one source, and what is to be run on each: systems with their digests."""

    items: tuple[tuple[Case, tuple[tuple[System, str], ...]], ...]
    store: Path


WARM_NDISP = 32


@dataclass(frozen=True)
class RunReport:
    """What an evaluation did."""

    run: int
    kept: int
    problems: tuple[str, ...]


Progress = Callable[[int, int], None]


def evaluate(
    cases: Sequence[Case],
    systems: Sequence[System],
    store: Store,
    *,
    jobs: int = 1,
    progress: Progress = lambda done, total: None,
) -> RunReport:
    """Run every system on every case that the store does not have yet; see `evaluate_each`."""
    return evaluate_each([(system, cases) for system in systems], store, jobs=jobs, progress=progress)


def evaluate_each(
    wanted: Sequence[tuple[System, Sequence[Case]]],
    store: Store,
    *,
    jobs: int = 1,
    progress: Progress = lambda done, total: None,
) -> RunReport:
    """Run systems on cases of their own, as far as the store does not have the results yet.

    Parameters
    ----------
    wanted : sequence of (System, sequence of Case)
    store : Store
        Results are committed case by case; an interrupted evaluation goes on where it was.
    jobs : int
        Worker processes, started by `spawn`; 1 runs in this process.
    progress : callable
        Called with the cases done and their number.

    Returns
    -------
    RunReport
        `problems` names the cases that could not be run at all; the others are unaffected.
    """
    done = store.done()
    work: dict[str, dict[Case, list[tuple[System, str]]]] = {}
    for system, cases in wanted:
        digest = system.digest()
        fresh: System = replace(system)  # type: ignore[type-var]  # without what `digest` has built
        for case in cases:
            if (case.key, system.name, digest) not in done:
                work.setdefault(case.source.name, {}).setdefault(case, []).append((fresh, digest))
    parts = [Work(tuple((case, tuple(todo)) for case, todo in items.items()), store.path) for items in work.values()]
    planned = sum(len(todo) for part in parts for _, todo in part.items)
    total = sum(len(part.items) for part in parts)
    problems: list[str] = []
    finished = 0
    for part, found in _each(parts, jobs):
        problems += found
        finished += len(part.items)
        progress(finished, total)
    kept = sum(len(cases) for _, cases in wanted) - planned
    return RunReport(len(store.done()) - len(done), kept, tuple(problems))


def _each(parts: Sequence[Work], jobs: int) -> Iterator[tuple[Work, list[str]]]:
    if jobs <= 1:
        for part in parts:
            yield part, run_part(part)
        return
    context = multiprocessing.get_context("spawn")
    with serial_linear_algebra(), ProcessPoolExecutor(jobs, mp_context=context) as pool:
        futures = {pool.submit(run_part, part): part for part in parts}
        for future in as_completed(futures):
            yield futures[future], future.result()


def run_part(part: Work) -> list[str]:
    """Run the cases of one source and write each to the store; return what could not be run.

    A case that cannot be read or scored is a problem, not an end.
    """
    store = Store(part.store)
    problems: list[str] = []
    pair: DatasetPair | None = None
    for case, todo in part.items:
        try:
            pair = pair or case.source.load()
            views = case.distort(pair.views)
        except (OSError, ValueError) as error:
            problems.append(f"{case.key}: {error}")
            continue
        rows = []
        for system, digest in todo:
            try:
                rows.append(measure(case, pair, views, warm(system), digest))
            except (OSError, ValueError) as error:
                problems.append(f"{case.key}: {system.name}: {error}")
        store.add(rows)
    return problems


@lru_cache(maxsize=256)
def warm(system: System) -> System:
    """Return the system as this process keeps it, after a small pair, so that building and loading are not measured."""
    draw = np.random.default_rng(0)
    coarse = draw.integers(0, 255, (48, 64, 3), np.uint8)
    image = np.asarray(cv2.resize(coarse, (192, 144), interpolation=cv2.INTER_CUBIC), np.uint8)
    system.run(Views(image, np.roll(image, -4, axis=1)), WARM_NDISP)
    return system


def measure(case: Case, pair: DatasetPair, views: Views, system: System, digest: str) -> Row:
    """Run one system on one case and score it.

    Raises
    ------
    ValueError
        The pair has no truth.
    """
    if pair.truth_px is None or pair.scored is None:
        raise ValueError(f"{pair.name} has no truth; leave it out")
    before = memory_mb("VmRSS") if reset_peak() else None
    cpu, wall = time.process_time(), time.perf_counter()
    outcome = system.run(views, pair.ndisp)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    peak = memory_mb("VmHWM") if before is not None else None
    taken = None if peak is None or before is None else peak - before
    row = Row(
        case=case.key,
        pair=pair.name,
        scene=pair.group,
        variant=str(case.variant),
        differs=pair.differs,
        system=system.name,
        kind=system.kind,
        digest=digest,
        **asdict(score(outcome.disparity_px, pair.truth_px, pair.scored)),
        cpu_s=cpu if outcome.cpu_s is None else outcome.cpu_s,
        wall_s=wall,
        peak_mb=taken if outcome.peak_mb is None else outcome.peak_mb,
        failure=outcome.failure,
    )
    return row if outcome.decision is None else _explained(row, outcome.decision)


def _explained(row: Row, decision: Decision) -> Row:
    """Add what the decision says, for the cost of each part, for ablation and for the regret list."""
    return replace(
        row,
        rules=decision.rules_fired,
        plan=tuple(f"{step.operator} by {step.chosen_by or 'default'}" for step in decision.steps()),
        findings=tuple(item.name for item in decision.findings),
        shares=_shares(decision),
    )


def _shares(decision: Decision) -> dict[str, float]:
    """Return the share of the time of facts, inference and operators."""
    total = sum(decision.timings_s.values()) or 1.0
    shares = {"facts": 0.0, "inference": 0.0, "operators": 0.0}
    for name, seconds in decision.timings_s.items():
        kind = "inference" if name == "inference" else "facts" if name.startswith("measurement.") else "operators"
        shares[kind] += seconds / total
    return shares


def reset_peak() -> bool:
    """Make the peak of the memory start anew; False where the platform cannot."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return False
    return True


def memory_mb(name: str) -> float | None:
    """Return a figure of this process in MB, e.g. VmRSS or VmHWM; None where the platform does not tell."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith(name):
                return int(line.split()[1]) / 1024.0
    except OSError:
        pass
    return None
