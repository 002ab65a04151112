"""What the reports of a pair cost: CPU time of saving with and without the page, and where it goes.

    python -m benchmarks.report [--pairs 24]

Rendered pairs of 320x240 px, each under another distortion. The bar is 0.15 s a pair for the HTML report.
"""

from __future__ import annotations

import argparse
import gc
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.batch_pairs import pairs
from expert import ExpertSystem, StereoPair
from expert.report import answer, as_html, as_markdown, read_run
from expert.report.pictures import pair_pictures
from expert.report.terrain import terrain
from expert.report.validity import disparity_pictures
from expert.result import Result

BAR_S = 0.15


def spent(work: Callable[[], object]) -> float:
    """Return the CPU time of one call, s, without what earlier calls left to collect."""
    gc.collect()
    start = time.process_time()
    work()
    return time.process_time() - start


def measure(result: Result, folder: Path) -> dict[str, float]:
    """Return CPU seconds by what is done; saving is measured twice with and without the page, in turn."""
    ways: dict[bool, list[float]] = {False: [], True: []}
    for html in (False, True, True, False):
        ways[html].append(spent(lambda html=html: result.save(folder / "run", html=html)))
    result.save(folder / "run")
    decision, files = read_run(folder / "run")
    answers = answer(decision)
    return {
        "save with the page": statistics.mean(ways[True]),
        "save without": statistics.mean(ways[False]),
        "the page": spent(lambda: as_html(decision, files, answers)),
        "of it pair pictures": spent(lambda: pair_pictures(files)),
        "of it disparity": spent(lambda: disparity_pictures(files)),
        "of it terrain": spent(lambda: terrain(files, "x")),
        "answers (also for Markdown)": spent(lambda: answer(decision)),
        "Markdown": spent(lambda: as_markdown(decision, answers)),
        "size of the page, MB": (folder / "run" / "report.html").stat().st_size / 1e6,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=24)
    options = parser.parse_args()
    system = ExpertSystem()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (made, views) in enumerate(pairs(options.pairs + 1)):
            stated = {"calibration": made.calibration, "attitude": made.attitude, "mount": made.mount}
            result = system.reconstruct(StereoPair(views.left, views.right, name=f"pair {number}", **stated))
            row = measure(result, Path(folder))
            if number:  # the first one compiles templates and kernels
                rows.append(row)
    print(f"{len(rows)} pairs, mean and largest")
    for name in rows[0]:
        values = [row[name] for row in rows]
        print(f"  {name:30s} {statistics.mean(values):7.3f} {max(values):7.3f}")
    extra = [row["save with the page"] - row["save without"] for row in rows]
    mean = statistics.mean(extra)
    verdict = "within" if mean <= BAR_S else "beyond"
    print(f"  {'HTML report, s a pair':30s} {mean:7.3f} {max(extra):7.3f}  {verdict} the bar of {BAR_S} s")


if __name__ == "__main__":
    main()
