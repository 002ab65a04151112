"""Measure the CPU time of the checks, filters and the probe after the matcher, beside their cost models.

    python -m benchmarks.matching_cost [--seed 0]

On a rendered pair of 640x480 px and 64 disparities, one OpenCV thread, the best of three runs of this process; shares
are of the semi-global matcher's time in the same process.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import cv2

from modules.catalog import operators, probes
from modules.simulation import TerrainParams, render_terrain
from modules.types import DisparityRange, Matching, Views

DISPARITIES = 64
MATCHER = "matching.semi_global_match"
PLANNED = ("consistency", "speckles", "refine", "confidence")  # slots whose product the next step starts from


def measure(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return the result and the least CPU time of three runs, s."""
    times = []
    for _ in range(3):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return result, min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    cv2.setNumThreads(1)
    made = render_terrain(TerrainParams(seed=parser.parse_args().seed))
    state = Matching(Views(made.left, made.right), DisparityRange(0, DISPARITIES))
    pixels = made.left.shape[0] * made.left.shape[1]
    matcher = operators()[MATCHER]
    state, whole = measure(partial(matcher.function, state, matcher.params()))
    print(f"{'operator':34s} {'ms':>8s} {'model':>8s} {'ns/px':>8s} {'share':>8s}")
    print(f"{MATCHER:34s} {1e3 * whole:8.1f} {1e3 * matcher.cost.seconds(pixels, DISPARITIES):8.1f}")
    after = [o for o in operators().values() if o.stage == "matching" and o.slot not in ("range", "matcher")]
    for operator in after:
        done, spent = measure(partial(operator.function, state, operator.params()))
        model = operator.cost.seconds(pixels, DISPARITIES)
        share = f"{100 * spent / whole:6.1f} %"
        print(f"{operator.name:34s} {1e3 * spent:8.1f} {1e3 * model:8.1f} {1e9 * spent / pixels:8.0f} {share:>8s}")
        if operator.slot in PLANNED:
            state = done
    probe = probes()["measurement.disparity_quality"]
    _, spent = measure(partial(probe.function, state))
    print(f"{probe.name:34s} {1e3 * spent:8.1f} {'':8s} {1e9 * spent / pixels:8.0f} {100 * spent / whole:6.1f} %")


if __name__ == "__main__":
    main()
