"""Print accuracy and the share of time of each step, per pair: `make bench`.

Beside each pair stands OpenCV's SGBM with tuned parameters and no correction, on the same pixels, with the disparity
range given. The development pairs are found through TERREX_DATA; without them one rendered pair is run.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.pairs import ScoredPair, development_pairs, rendered_pair
from expert import ExpertSystem

BAD_PX = 2.0
BLOCK_PX = 5


def main() -> None:
    system = ExpertSystem()
    warm_up = rendered_pair(seed=99)
    system.reconstruct(warm_up.pair)  # compiles, loads and fills caches, which a single run would be charged for
    pairs = [rendered_pair()]
    data = os.environ.get("TERREX_DATA")
    if data:
        pairs += development_pairs(Path(data))
    else:
        print("TERREX_DATA is not set: no development pairs, only a rendered one.")
    for scored in pairs:
        measure(system, scored)


def measure(system: ExpertSystem, scored: ScoredPair) -> None:
    start = time.perf_counter()
    result = system.reconstruct(scored.pair)
    total = time.perf_counter() - start
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        result.save(Path(folder) / "out")
        writing = time.perf_counter() - start
    rows, columns = scored.pair.left.shape[:2]
    print(f"\n{scored.pair.name} ({columns}x{rows}): {result.decision.status}, {total + writing:.2f} s")
    if scored.truth_px is not None and scored.scored is not None:
        own = bad(result.disparity_px, scored.truth_px, scored.scored)
        plain = bad(plain_sgbm(scored), scored.truth_px, scored.scored)
        print(f"  bad-{BAD_PX:g}, missing counted as wrong: {own:.1f} %; SGBM without correction {plain:.1f} %")
    for what, seconds in shares(result.timings, total, writing).items():
        print(f"  {100 * seconds / (total + writing):5.1f} %  {seconds * 1000:8.1f} ms  {what}")


def shares(timings: dict[str, float], total: float, writing: float) -> dict[str, float]:
    """Group the measured times: facts together, inference together, each operator by itself, the rest."""
    grouped: dict[str, float] = defaultdict(float)
    for name, seconds in timings.items():
        group = "facts" if name.startswith("measurement.") else "inference" if name.startswith("infer") else name
        grouped[group] += seconds
    grouped["anything else"] = max(0.0, total - sum(timings.values()))
    grouped["writing"] = writing
    return dict(sorted(grouped.items(), key=lambda item: -item[1]))


def bad(disparity_px: NDArray[np.float32], truth_px: NDArray[np.float32], scored: NDArray[np.bool_]) -> float:
    """Return the share in % of scored pixels that are missing or wrong by more than `BAD_PX`."""
    good = np.abs(disparity_px - truth_px) <= BAD_PX  # a comparison with NaN is false
    return float(100.0 * (1.0 - good[scored].mean()))


def plain_sgbm(scored: ScoredPair) -> NDArray[np.float32]:
    """Return the disparity of OpenCV's SGBM with tuned parameters on the pair as it is."""
    count = -(-scored.ndisp // 16) * 16
    # SGBM leaves the first `count` columns out; a border on the left gives them a chance.
    left, right = (
        cv2.copyMakeBorder(image, 0, 0, count, 0, cv2.BORDER_REPLICATE)
        for image in (scored.pair.left, scored.pair.right)
    )
    weight = (left.shape[2] if left.ndim == 3 else 1) * BLOCK_PX**2
    matcher = cv2.StereoSGBM_create(
        minDisparity=0,
        numDisparities=count,
        blockSize=BLOCK_PX,
        P1=8 * weight,
        P2=32 * weight,
        disp12MaxDiff=1,
        preFilterCap=63,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    found = matcher.compute(left, right)[:, count:].astype(np.float32) / 16.0
    return np.where(found >= 0, found, np.float32(np.nan))


if __name__ == "__main__":
    main()
