"""Measure how the own semi-global matcher grows with pixels, disparities and threads.

    python -m benchmarks.matching_scaling [--plot FILE]

Times are CPU seconds of one thread, memory is extra. The speed-up by two threads is in wall-clock time, so it needs a
quiet machine: the load is printed, and beside the speed-up what the machine itself gives to two plain loops, one that
computes and one that moves memory. What cannot be shared out is measured in CPU time, which is right on a busy machine
too.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.matching import OWN, SGBM, cpu_seconds, extra_mb, made_pair, run
from modules.types import DisparityRange

WIDTHS, COUNTS = (320, 640, 1280), (32, 64, 128, 256)
THREADED = ((640, 64), (1280, 128), (1280, 256))  # columns and disparities
REPEATS = 3
STEPS, MEMORY_BYTES = 30_000_000, 200_000_000  # of the plain loops


@dataclass(frozen=True)
class Cell:
    """What one match costs: columns, rows and disparities; CPU time with one thread, s; extra memory, MB."""

    columns: int
    rows: int
    count: int
    seconds: float
    sgbm_seconds: float
    memory_mb: float

    @property
    def work(self) -> int:
        """Pixels times disparities."""
        return self.columns * self.rows * self.count


def measure(columns: int, count: int) -> Cell:
    """Return what a match of a pair of 4:3 costs."""
    rows = columns * 3 // 4
    views, search = made_pair(columns, rows), DisparityRange(0, count)
    own = cpu_seconds(partial(run, OWN, {"threads": 1}, views, search))
    sgbm = cpu_seconds(partial(run, SGBM, {}, views, search))
    return Cell(columns, rows, count, own, sgbm, extra_mb(OWN, {}, (columns, rows, count)))


def scaling() -> list[Cell]:
    """Print and return the time and memory over pixels and disparities."""
    cells = [measure(columns, count) for columns in WIDTHS for count in COUNTS if 2 * count <= columns]
    print("\nown semi-global: CPU s (ns per pixel and disparity), extra MB (bytes per pixel and disparity)")
    print(f"{'':12s}" + "".join(f"{f'{count} disparities':>26s}" for count in COUNTS))
    for columns in WIDTHS:
        row = [cell for cell in cells if cell.columns == columns]
        texts = (
            f"{c.seconds:8.3f} ({1e9 * c.seconds / c.work:4.2f}) {c.memory_mb:5.0f} ({1e6 * c.memory_mb / c.work:4.2f})"
            for c in row
        )
        print(f"{f'{columns}x{columns * 3 // 4}':12s}" + "".join(f"{text:>26s}" for text in texts))
    for label, value in (("time", lambda c: c.seconds), ("memory", lambda c: c.memory_mb)):
        power = np.polyfit([np.log(c.work) for c in cells], [np.log(value(c)) for c in cells], 1)[0]
        print(f"{label} grows with the power {power:.2f} of pixels times disparities")
    return cells


@njit(nogil=True)
def compute_steps(number: int) -> float:
    """Compute without touching memory."""
    value = 0.5
    for _ in range(number):
        value = value * 1.0000001 + 0.3 - value * value * 1e-9
    return value


@njit(nogil=True)
def move_bytes(source: NDArray[np.uint8], target: NDArray[np.uint8]) -> None:
    """Read and write memory and compute next to nothing."""
    for k in range(source.shape[0]):
        target[k] = source[k] + np.uint8(1)


def wall_seconds(work: Callable[[], object]) -> float:
    """Return the least wall-clock time of several calls, after one that is not counted."""
    work()
    times = []
    for _ in range(2 * REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def ceilings() -> dict[str, float]:
    """Return by how much two threads of this machine are faster at plain loops, which share nothing."""
    source, target = np.zeros(MEMORY_BYTES, np.uint8), np.ones(MEMORY_BYTES, np.uint8)
    parts = [slice(0, MEMORY_BYTES // 2), slice(MEMORY_BYTES // 2, None)]
    loops: dict[str, list[Callable[[], object]]] = {
        "computing": [partial(compute_steps, STEPS)] * 2,
        "moving memory": [partial(move_bytes, source[part], target[part]) for part in parts],
    }
    found = {}
    with ThreadPoolExecutor(2) as pool:
        for name, pair in loops.items():
            alone = wall_seconds(lambda pair=pair: [loop() for loop in pair])
            found[name] = alone / wall_seconds(lambda pair=pair: list(pool.map(lambda loop: loop(), pair)))
    return found


def threads() -> tuple[dict[str, float], dict[str, float]]:
    """Print and return the speed-up by two threads, and that of plain loops."""
    load = os.getloadavg()[0]
    cv2.setNumThreads(2)  # the limit for operators too
    print(f"\ntwo threads beside one, wall-clock (load {load:.1f} when it began; more than 0.2 falsifies it)")
    plain = ceilings()
    print("  plain loops: " + ", ".join(f"{name} {ratio:.2f} times" for name, ratio in plain.items()))
    found = {}
    for columns, count in THREADED:
        views, search = made_pair(columns, columns * 3 // 4), DisparityRange(0, count)
        spent = [wall_seconds(partial(run, OWN, {"threads": n}, views, search)) for n in (1, 2)]
        start = time.process_time(), time.thread_time()
        run(OWN, {"threads": 2}, views, search)
        whole, serial = time.process_time() - start[0], time.thread_time() - start[1]
        share = serial / whole
        label = f"{columns}x{columns * 3 // 4}x{count}"
        found[label] = spent[0] / spent[1]
        print(
            f"  {label:14s} {spent[0]:.3f} s and {spent[1]:.3f} s: {found[label]:.2f} times; "
            f"{100 * share:.1f} % of the CPU time is serial, which admits {2 / (1 + share):.2f} times"
        )
    return found, plain


def draw(cells: list[Cell], speedups: dict[str, float], plain: dict[str, float], path: Path) -> None:
    """Plot time, memory and the speed-up."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure, (left, middle, right) = pyplot.subplots(1, 3, figsize=(15, 4.6), layout="constrained")
    span = np.array([min(c.work for c in cells), max(c.work for c in cells)])
    for columns in WIDTHS:
        row = [c for c in cells if c.columns == columns]
        label = f"{columns} x {columns * 3 // 4} px"
        (line,) = left.loglog([c.work for c in row], [c.seconds for c in row], "o-", label=label)
        left.loglog([c.work for c in row], [c.sgbm_seconds for c in row], "x:", color=line.get_color(), alpha=0.6)
        middle.loglog([c.work for c in row], [c.memory_mb for c in row], "o-", label=label)
        for c in row:
            left.annotate(str(c.count), (c.work, c.seconds), xytext=(-3, 7), textcoords="offset points", fontsize=7)
    for axes, values in ((left, [c.seconds for c in cells]), (middle, [c.memory_mb for c in cells])):
        scale = np.exp(np.mean(np.log(values) - np.log([c.work for c in cells])))
        axes.loglog(span, scale * span, color="0.7", linewidth=1, zorder=0, label="in proportion")
        axes.grid(alpha=0.3, which="both")
        axes.set_xlabel("pixels x disparities")
    left.plot([], [], "x:", color="0.4", label="SGBM 3-way")
    left.set(title="Time of one match (numbers: disparities)", ylabel="CPU time, s")
    middle.set(title="Memory of one match", ylabel="extra memory, MB")
    for axes in (left, middle):
        axes.legend(fontsize=8)
    right.bar(list(speedups), list(speedups.values()), width=0.5, color="0.6")
    for number, ratio in enumerate(speedups.values()):
        right.annotate(f"{ratio:.2f}", (number, ratio), ha="center", va="bottom")
    for (name, ratio), style in zip(plain.items(), ("--", ":"), strict=True):
        right.axhline(ratio, linestyle=style, color="C3", label=f"plain loop {name}: {ratio:.2f}")
    right.set(title="Speed-up by the second thread", ylabel="times", ylim=(0, 2.3))
    right.legend(fontsize=8, loc="upper left")
    figure.savefig(path, dpi=110)
    print(f"plotted in {path}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plot", type=Path, help="file for the plot")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    cells = scaling()
    speedups, plain = threads()
    if args.plot:
        args.plot.parent.mkdir(parents=True, exist_ok=True)
        draw(cells, speedups, plain, args.plot)


if __name__ == "__main__":
    main()
