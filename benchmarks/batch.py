"""Measure long runs on rendered pairs of 320x240 px: throughput, overhead, kills, growth.

    python -m benchmarks.batch [--only throughput overhead kills growth] [--pairs N] [--kills K] [--growth-pairs N]

`throughput` compares `--jobs 2` with `--jobs 1`, and shows beside it what the processors give at all: a plain loop, and
reconstructions without anything of a batch, in one process and in two at once. `overhead` compares a batch of one
worker with a loop of `reconstruct` and `save`, and says what a report costs. `kills` ends a run by SIGKILL again and
again and compares what is left with an undisturbed run. `growth` reconstructs many pairs in one process and fits a line
to its memory. Pairs stay in `--work` from run to run; results do not.
"""

from __future__ import annotations

import argparse
import gc
import resource
import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.batch_ceiling import ceiling
from benchmarks.batch_kills import kills
from benchmarks.batch_pairs import QUIET, pairs, write_pairs
from expert import ExpertSystem, StereoPair
from expert.batch import Batch, BatchItem, Outcome, Progress

SECTIONS = ("throughput", "overhead", "kills", "growth")
SETTLING = 200  # pairs until caches and pools have their size
SAMPLES = 50
SMALL = (160, 120)  # px: what is left behind by a pair does not hang on its size, what it takes does
REPORTS = 20  # pairs that are saved with a report, too


def run_batch(items: Sequence[BatchItem], out: Path, jobs: int) -> tuple[float, float]:
    """Run a batch with one thread per worker; return its seconds, and those between its first and last result."""
    shutil.rmtree(out, ignore_errors=True)
    ended: list[float] = []

    def note(progress: Progress, outcome: Outcome) -> None:
        assert outcome.status == "reconstructed" or outcome.decision_id, outcome.reason
        ended.append(time.perf_counter())

    start = time.perf_counter()
    made = Batch(items, out, QUIET)
    made.run(made.plan(), jobs=jobs, progress=note)
    total = time.perf_counter() - start
    shutil.rmtree(out)
    return total, ended[-1] - ended[0]


def throughput(items: Sequence[BatchItem], work: Path) -> None:
    """Print pairs per second with one worker and with two, and what two processes gain at all."""
    plain, bare = ceiling(items[: min(len(items), 100)])
    print(f"two processes at once do {plain:.2f} times as much of a plain loop, {bare:.2f} times as many bare pairs")
    (one, one_steady), (two, two_steady) = (run_batch(items, work / "out", jobs) for jobs in (1, 2))
    print(
        f"{len(items)} pairs, one thread per worker: {len(items) / one:.2f} pairs/s with --jobs 1, "
        f"{len(items) / two:.2f} with --jobs 2: {one / two:.2f} times, {one_steady / two_steady:.2f} without the start"
    )


def overhead(items: Sequence[BatchItem], work: Path) -> None:
    """Print what a batch of one worker takes longer than a loop over the pairs, and what a report takes."""
    system = ExpertSystem()
    cv2.setNumThreads(1)

    def loop(html: bool, some: Sequence[BatchItem]) -> None:
        for item in some:
            pair = StereoPair.load(item.left, item.right, calibration=item.stated.calibration)
            system.reconstruct(pair).save(work / "out" / item.name, html=html)

    loop(True, items[:1])
    loop_s, loop_cpu = timed(lambda: loop(False, items))
    html_s, _ = timed(lambda: loop(True, items[:REPORTS]))
    bare_s, _ = timed(lambda: loop(False, items[:REPORTS]))
    shutil.rmtree(work / "out")
    (batch_s, steady_s), batch_cpu = timed_batch(items, work)
    _, start_cpu = timed_batch(items[:1], work)
    count = len(items)
    marginal = (batch_cpu - start_cpu) / (count - 1) * count
    loop_each, steady_each = loop_s / count, steady_s / (count - 1)
    print(
        f"{count} pairs: {1e3 * loop_each:.1f} ms a pair in a loop, {1e3 * steady_each:.1f} in a batch: "
        f"{steady_each / loop_each - 1:+.1%}; with start and end of the batch {batch_s / loop_s - 1:+.1%}; "
        f"CPU {marginal / loop_cpu - 1:+.1%}, {batch_cpu / loop_cpu - 1:+.1%} with start and end"
    )
    print(f"a report takes {1e3 * (html_s - bare_s) / min(count, REPORTS):.0f} ms more a pair")


def timed(act: Callable[[], object]) -> tuple[float, float]:
    """Return the seconds and the CPU seconds of an action, those of ended child processes included."""
    start, cpu = time.perf_counter(), cpu_s()
    act()
    return time.perf_counter() - start, cpu_s() - cpu


def timed_batch(items: Sequence[BatchItem], work: Path) -> tuple[tuple[float, float], float]:
    """Return the seconds of a batch of one worker, in all and from first to last result, and its CPU seconds."""
    before = cpu_s()
    return run_batch(items, work / "out", 1), cpu_s() - before


def cpu_s() -> float:
    """Return the CPU time of this process and of its children that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(item.ru_utime + item.ru_stime for item in used)


def growth(count: int) -> None:
    """Print how the resident memory of a process that reconstructs many pairs changes, by a line fitted to it."""
    system = ExpertSystem()
    cv2.setNumThreads(1)
    every = max((count - SETTLING) // SAMPLES, 1)
    at: list[int] = []
    held: list[float] = []
    for number, (made, views) in enumerate(pairs(count, SMALL)):
        system.reconstruct(StereoPair(views.left, views.right, calibration=made.calibration, mount=made.mount))
        if number >= SETTLING and (number - SETTLING) % every == 0:
            gc.collect()
            at.append(number)
            held.append(resident_mb())
    (slope, _), spread = np.polyfit(at, held, 1, cov=True)
    third = max(len(held) // 3, 1)
    print(
        f"{count} pairs in one process: {held[0]:.0f} MB after {at[0]}, {held[-1]:.0f} MB after {at[-1]}; fitted "
        f"{1e3 * slope:+.2f} +- {1e3 * np.sqrt(spread[0, 0]):.2f} MB per 1000 pairs (1 sigma); median of the first "
        f"third of {len(held)} samples {np.median(held[:third]):.1f} MB, of the last {np.median(held[-third:]):.1f} MB"
    )


def resident_mb() -> float:
    """Return the resident memory of this process, MB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def main() -> None:
    """Print what is measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=SECTIONS)
    parser.add_argument("--pairs", type=int, default=1000, help="of throughput and overhead")
    parser.add_argument("--kill-pairs", type=int, default=200)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0, help="of the moments of the kills")
    parser.add_argument("--growth-pairs", type=int, default=5000)
    parser.add_argument("--work", type=Path, default=Path("build/bench-batch"), help="folder for pairs and results")
    args = parser.parse_args()
    if "throughput" in args.only or "overhead" in args.only:
        items = write_pairs(args.work / "pairs", args.pairs)
        if "throughput" in args.only:
            throughput(items, args.work)
        if "overhead" in args.only:
            overhead(items, args.work)
    if "kills" in args.only:
        kills(args.work, args.kill_pairs, args.kills, args.seed)
    if "growth" in args.only:
        growth(args.growth_pairs)


if __name__ == "__main__":
    main()
