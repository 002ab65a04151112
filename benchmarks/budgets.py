"""Print how often time and memory budgets are kept, by how much they are exceeded, and what they cost.

    TERREX_DATA=... python -m benchmarks.budgets [--every 6] [--budgets 0.03 0.05 0.1 0.2 0.3]

Pairs of the development set at half, whole and one and a half times their size, the range given and estimated. A run
whose decision says that the cheapest plan takes longer than the budget (`budget-too-small`) counts apart. The first run
of a process, which compiles and loads, is left out. Memory is the peak of the process above its size before the run.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from expert import ExpertSystem, StereoPair
from expert.costs import measure_speed
from expert.evaluate.run import memory_mb, reset_peak
from modules.formats.datasets import DatasetPair, read_index

SCALES = (0.5, 1.0, 1.5)
TIME_BUDGETS_S = (0.03, 0.05, 0.1, 0.2, 0.3)
MEMORY_BUDGETS_MB = (20.0, 40.0, 80.0)
TOO_SMALL = {"budget-too-small", "memory-too-small"}
MATCHERS = ("semi_global_match", "semi_global_block_match", "block_match")


@dataclass(frozen=True)
class Outcome:
    """What one run took: s or MB; the matcher, whether the decision gave warning, and the pixels with a disparity."""

    taken: float
    matcher: str
    warned: bool
    density: float


def scaled(pair: DatasetPair, factor: float, given: bool) -> StereoPair:
    """Return a pair at another size."""
    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    left, right = (
        np.ascontiguousarray(cv2.resize(image, None, fx=factor, fy=factor, interpolation=how))
        for image in (pair.views.left, pair.views.right)
    )
    limit = min(round(pair.ndisp * factor), left.shape[1] - 1)
    return StereoPair(left, right, disparity_range_px=(0, limit) if given else None)


def tried(system: ExpertSystem, pair: StereoPair, memory: bool) -> Outcome:
    """Run one pair and measure CPU time or memory."""
    before = memory_mb("VmRSS") if memory and reset_peak() else None
    begun = time.process_time()
    result = system.reconstruct(pair)
    taken = time.process_time() - begun
    if memory:
        peak = memory_mb("VmHWM")
        taken = float("nan") if before is None or peak is None else peak - before
    names = {finding.name for finding in result.decision.findings}
    matcher = result.decision.operator("matching.matcher").rpartition(".")[2]
    return Outcome(taken, matcher, bool(TOO_SMALL & names), float(np.isfinite(result.disparity_px).mean()))


def tell(title: str, budget: float, outcomes: list[Outcome]) -> None:
    """Print one line."""
    due = [item for item in outcomes if not item.warned]
    kept = sum(item.taken <= budget for item in due)
    excess = max((item.taken / budget - 1 for item in due), default=0.0)
    said = f"{kept}/{len(due)} kept" if due else "none promised"
    used = ", ".join(f"{name} {n}" for name in MATCHERS if (n := sum(item.matcher == name for item in outcomes)))
    density = 100 * float(np.mean([item.density for item in outcomes]))
    print(
        f"{title:22s}{said:>14s}{max(100 * excess, 0.0):9.0f}%{len(outcomes) - len(due):9d}"
        f"{np.mean([item.taken / budget for item in outcomes]):8.2f}{density:9.1f}  {used}",
        flush=True,
    )


def each(pairs: list[DatasetPair]) -> Iterator[StereoPair]:
    for pair in pairs:
        for factor in SCALES:
            for given in (True, False):
                yield scaled(pair, factor, given)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"))
    parser.add_argument("--every", type=int, default=6)
    parser.add_argument("--budgets", type=float, nargs="*", default=TIME_BUDGETS_S, help="s")
    parser.add_argument("--memory", type=float, nargs="*", default=MEMORY_BUDGETS_MB, help="MB")
    args = parser.parse_args()
    if not args.data:
        raise SystemExit("no data: set TERREX_DATA or give --data FOLDER")
    pairs = list(each(list(read_index(Path(args.data), "dev"))[:: args.every]))
    speed = measure_speed()
    print(f"{len(pairs)} runs per budget; this machine has {speed:g} times the speed of the reference one")
    print(f"{'budget':22s}{'':>14s}{'excess':>10s}{'warned':>9s}{'taken':>8s}{'density':>9s}")
    for budget in args.budgets:
        system = ExpertSystem(time_budget_s=budget, machine_speed=speed)
        system.reconstruct(pairs[0])
        tell(f"{budget:g} s of CPU", budget, [tried(system, pair, memory=False) for pair in pairs])
    for budget in args.memory:
        system = ExpertSystem(memory_budget_mb=budget)
        system.reconstruct(pairs[0])
        tell(f"{budget:g} MB", budget, [tried(system, pair, memory=True) for pair in pairs])


if __name__ == "__main__":
    main()
