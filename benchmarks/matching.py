"""Measure the matchers: accuracy, time, memory, scaling and pixel locking, beside OpenCV and CNES Pandora.

    TERREX_DATA=... python -m benchmarks.matching [--every N] [--only SECTION ...] [--pandora PYTHON]

Sections: accuracy (needs TERREX_DATA), cost, overhead, locking, start. Pandora runs in an environment
of its own, made by `make bench-pandora`; without it its rows are left out. Times are CPU seconds, memory is extra.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from benchmarks.pairs import bad_1_percent
from expert.evaluate.peer import pandora_at
from modules.catalog import operators
from modules.formats.datasets import read_index
from modules.matching.common import Bytes
from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right
from modules.simulation.terrain import TerrainParams, render_terrain
from modules.types import DisparityRange, FloatImage, Matching, Views

CHECKS = ("matching.check_left_right", "matching.remove_speckles")
SIZES = ((320, 240, 32), (640, 480, 64), (1280, 960, 192))
OWN, SGBM, BLOCKS = "matching.semi_global_match", "matching.semi_global_block_match", "matching.block_match"
SYSTEMS: dict[str, tuple[str, dict]] = {
    "own semi-global": (OWN, {}),
    "own, 4 paths": (OWN, {"paths": 4}),
    "own, coarse to fine": (OWN, {"coarse_to_fine": True}),
    "SGBM 3-way": (SGBM, {}),
    "SGBM 5 paths": (SGBM, {"mode": "sgbm"}),
    "SGBM 8 paths": (SGBM, {"mode": "hh"}),
    "SGBM 4 paths": (SGBM, {"mode": "hh4"}),
    "block matching": (BLOCKS, {}),
}
REPEATS = 3
PANDORA = Path("build/pandora/bin/python")


def run(name: str, values: dict, views: Views, search: DisparityRange, check: bool = False) -> FloatImage:
    """Return the disparity of a matcher, alone or with the usual checks."""
    catalog = operators()
    state = Matching(views, search)
    for step, params in ((name, values), *((each, {}) for each in (CHECKS if check else ()))):
        state = catalog[step].function(state, catalog[step].params(**params))
    assert state.disparity is not None
    return state.disparity.disparity_px


def accuracy(data: Path, every: int, python: Path) -> None:
    """Print mean bad-1 per distortion, of the matcher alone and with checks, and the ratios that are bars."""
    kinds = [kind for kind in REFERENCE_DISTORTIONS if kind != "misrectified"]
    names = ("own semi-global", "own, coarse to fine", "SGBM 3-way", "block matching")
    found: dict[tuple[str, str, bool], list[float]] = {}
    same: dict[str, list[float]] = {}
    with pandora_at(python) as pandora:
        for number, pair in enumerate(read_index(data, "dev")):
            if number % every:
                continue
            search = DisparityRange(0, pair.ndisp)
            for kind in kinds:
                views = distort_right(pair.views, kind, seed=number)
                for name in names:
                    for check in (False, True):
                        bad = bad_1_percent(run(*SYSTEMS[name], views, search, check), pair)
                        found.setdefault((name, kind, check), []).append(bad)
                        if kind == "clean" and not pair.differs:
                            same.setdefault(f"{name}{', checked' if check else ''}", []).append(bad)
            if pandora is not None and not pair.differs:
                found_by_peer, _ = pandora.match(pair.views, search)
                same.setdefault("Pandora, cross-checked", []).append(bad_1_percent(found_by_peer, pair))
    print("\nmean bad-1 in %, missing counted as wrong, range given, not occluded")
    print(f"  {'':34s}" + "".join(f"{kind:>9s}" for kind in kinds) + f"{'mean':>9s}")
    means = {}
    for name in names:
        for check in (False, True):
            row = [float(np.mean(found[name, kind, check])) for kind in kinds]
            label = f"{name}{', checked' if check else ''}"
            means[label] = float(np.mean(row))
            print(f"  {label:34s}" + "".join(f"{value:9.2f}" for value in (*row, means[label])))
    print(f"\npairs without radiometric difference ({len(same[names[0]])}), clean")
    for name, values in same.items():
        print(f"  {name:34s}{np.mean(values):9.2f}")
    for check in ("", ", checked"):
        own, other = f"own semi-global{check}", f"SGBM 3-way{check}"
        print(f"  own / SGBM{check}: {np.mean(same[own]) / np.mean(same[other]):.3f} (bar 0.9)", end="")
        print(f"; over all distortions {means[own] / means[other]:.3f} (bar 0.6)")
        if "Pandora, cross-checked" in same:
            print(
                f"  own{check} / Pandora: {np.mean(same[own]) / np.mean(same['Pandora, cross-checked']):.3f} (bar 0.85)"
            )


def made_pair(columns: int, rows: int) -> Views:
    """Return a textured pair; its disparities do not matter."""
    noise = np.random.default_rng(1).normal(0, 1, (rows, columns + 32)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.2)
    image = np.clip(128 + 45 * smooth / smooth.std(), 0, 255).astype(np.uint8)
    return Views(np.ascontiguousarray(image[:, :columns]), np.ascontiguousarray(image[:, 20 : 20 + columns]))


def cpu_seconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the least CPU time of several calls, after one that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def extra_mb(name: str, values: dict, size: tuple[int, int, int]) -> float:
    """Return by how much a match raises the peak memory of a process of its own, MB."""
    columns, rows, count = size
    code = (
        "import json\nfrom pathlib import Path\nfrom benchmarks.matching import made_pair, peak_mb, run\n"
        "from modules.types import DisparityRange\n"
        f"values = json.loads({json.dumps(values)!r})\n"
        f"run({name!r}, values, made_pair(96, 64), DisparityRange(0, 16)); views = made_pair({columns}, {rows})\n"
        "before = peak_mb(reset=True)\n"
        f"run({name!r}, values, views, DisparityRange(0, {count}))\n"
        "print(peak_mb() - before)"
    )
    return float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)


def peak_mb(reset: bool = False) -> float:
    """Return the peak memory of this process since the last reset, MB (Linux)."""
    if reset:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def alternately(works: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Return the median CPU time of each of several works that take turns, so that a busy machine slows all alike."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for turn in range(repeats + 1):
        for name, work in works.items():
            start = time.process_time()
            work()
            if turn:  # the first is not counted
                times[name].append(time.process_time() - start)
    return {name: float(np.median(spent)) for name, spent in times.items()}


def direct_opencv(left: Bytes, right: Bytes, count: int, blocks: bool) -> Callable[[], object]:
    """Return OpenCV called as its users call it: nothing is checked or converted."""
    if blocks:
        matcher = cv2.StereoBM.create(count, 15)
    else:
        matcher = cv2.StereoSGBM.create(0, count, 5, 200, 800, -1, 63, 10, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    return lambda: matcher.compute(left, right)


def overhead(turns: int = 60) -> None:
    """Print what the contract costs beside OpenCV called directly on the pair, and on the pair with its border widened.

    OpenCV leaves out the columns from which a match may lie outside the right image, and block matching half a block on
    every side; who wants them widens the images by hand, as the contract does.
    """
    print(
        "\nCPU time through the contract / OpenCV called directly: on the pair as it is; and on the widened pair, which"
    )
    print("gives the same pixels")
    for name, operator, blocks in (("SGBM 3-way", SGBM, False), ("block matching", BLOCKS, True)):
        ratios = []
        for columns, rows, count in SIZES:
            views, search = made_pair(columns, rows), DisparityRange(0, count)
            half = 7 if blocks else 0
            wide = [
                np.asarray(cv2.copyMakeBorder(image, half, half, count + half, half, cv2.BORDER_REPLICATE), np.uint8)
                for image in (views.left, views.right)
            ]
            spent = alternately(
                {
                    "contract": lambda o=operator, v=views, r=search: run(o, {}, v, r),
                    "as it is": direct_opencv(views.left, views.right, count, blocks),
                    "widened": direct_opencv(wide[0], wide[1], count, blocks),
                },
                max(turns * 320 // columns * 240 // rows, 7),
            )
            ratios.append(
                f"{columns}x{rows}x{count} {spent['contract'] / spent['as it is']:.3f} "
                f"{spent['contract'] / spent['widened']:.3f}"
            )
        print(f"  {name:16s} " + "; ".join(ratios) + " (bar 1.15)")


def cost(python: Path) -> None:
    """Print CPU time and memory at several sizes."""
    print(f"\n{'CPU s, extra MB':24s}" + "".join(f"{f'{c}x{r}x{d}':>20s}" for c, r, d in SIZES))
    views = {size: made_pair(*size[:2]) for size in SIZES}
    table: dict[str, list[tuple[float, float]]] = {}
    for name, (operator, values) in SYSTEMS.items():
        for size in SIZES:
            search = DisparityRange(0, size[2])
            seconds = cpu_seconds(lambda o=operator, v=values, s=size, r=search: run(o, v, views[s], r))
            table.setdefault(name, []).append((seconds, extra_mb(operator, values, size)))
    table["SGBM 3-way, direct"] = [
        (cpu_seconds(direct_opencv(views[size].left, views[size].right, size[2], False)), float("nan"))
        for size in SIZES
    ]
    with pandora_at(python) as pandora:
        if pandora is not None:
            spent = [pandora.match(views[size], DisparityRange(0, size[2]))[1] for size in SIZES]
            table["Pandora"] = [(one.cpu_s, one.extra_mb) for one in spent]
    for name, row in table.items():
        print(f"{name:24s}" + "".join(f"{seconds:12.3f} {memory:7.0f}" for seconds, memory in row))
    own, three = table["own semi-global"], table["SGBM 3-way, direct"]
    print("own / SGBM 3-way, direct: " + ", ".join(f"{a[0] / b[0]:.2f}" for a, b in zip(own, three, strict=True)))
    if "Pandora" in table:
        print("Pandora / own: " + ", ".join(f"{b[0] / a[0]:.1f}" for a, b in zip(own, table["Pandora"], strict=True)))


def locking() -> None:
    """Print how disparities prefer whole pixels on rendered terrain."""
    made = render_terrain(TerrainParams(seed=3))
    truth, seen = made.disparity_px, made.nonocc
    top = int(np.nanmax(truth[seen])) + 4
    print("\nrendered terrain: mean error by the fraction of the true disparity (locking is its range), px")
    for subpixel in ("parabola", "equiangular", "intensity"):
        found = run(OWN, {"subpixel": subpixel}, Views(made.left, made.right), DisparityRange(0, top))
        error = found - truth
        good = seen & (np.abs(error) < 1)
        bins = np.floor((truth[good] % 1.0) * 10).astype(int) % 10
        means = np.array([error[good][bins == k].mean() for k in range(10)])
        spread = float(np.ptp(means))
        print(
            f"  {subpixel:12s} locking {spread:.3f}, median |error| {np.median(np.abs(error[good])):.3f}, means {means}"
        )


def start() -> None:
    """Print how long the first match takes in a new process: with an empty cache, and with a filled one."""
    code = (
        "import time; from benchmarks.matching import made_pair, run, OWN; from modules.types import DisparityRange\n"
        "views = made_pair(160, 120); t = time.process_time(), time.perf_counter()\n"
        "run(OWN, {}, views, DisparityRange(0, 32)); print(time.process_time() - t[0], time.perf_counter() - t[1])"
    )
    with tempfile.TemporaryDirectory() as cache:
        for label in ("compiled", "cached"):
            done = subprocess.run(
                [sys.executable, "-c", code],
                check=True,
                capture_output=True,
                text=True,
                env={**os.environ, "NUMBA_CACHE_DIR": cache},
            )
            cpu, wall = (float(number) for number in done.stdout.split())
            print(
                f"\nfirst match, {label}: {cpu:.2f} s CPU, {wall:.2f} s"
                + (f" ({done.stderr.strip()})" if done.stderr else "")
            )


def main() -> None:
    sections = ("accuracy", "cost", "overhead", "locking", "start")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--every", type=int, default=1, help="take every N-th pair only")
    parser.add_argument("--only", nargs="+", choices=sections, default=sections)
    parser.add_argument("--pandora", type=Path, default=PANDORA, help="python of Pandora's environment")
    args = parser.parse_args()
    np.set_printoptions(precision=3, suppress=True, linewidth=140)
    cv2.setNumThreads(1)
    if "accuracy" in args.only:
        if not args.data:
            raise SystemExit("no data: set TERREX_DATA or give --data FOLDER, or leave accuracy out by --only")
        accuracy(Path(args.data), args.every, args.pandora)
    if "cost" in args.only:
        cost(args.pandora)
    if "overhead" in args.only:
        overhead()
    if "locking" in args.only:
        locking()
    if "start" in args.only:
        start()


if __name__ == "__main__":
    main()
