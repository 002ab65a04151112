"""Print how much a scene changes from one pair to the next, and what taking over the earlier decision saves.

The evidence behind MEA090, MEA091, COR081, COR082, MAT090 and MAT094: every N-th development pair is followed by the
same scene seen a few pixels aside, by the same scene a tenth darker, and by another scene of one size. For each the
change of the thumbnails; then CPU time and bad-1 in % with and without the earlier decision, in each profile.

    TERREX_DATA=FOLDER python examples/evidence/sequence.py [--every 4]
"""

from __future__ import annotations

import time

import numpy as np
from development import development_pairs, of_another_scene

from expert import Decision, ExpertSystem, StereoPair
from expert.warm import change_dn, thumbnail
from modules.formats.datasets import DatasetPair

STEP_PX = 12  # columns and rows by which the view moves, of about 450 x 375
PROFILES = ("fast", "balanced")


def view(pair: DatasetPair, row: int, column: int, gain: float = 1.0) -> StereoPair:
    """Return a part of a pair, as if the cameras looked aside, under other light."""
    rows, columns = pair.views.shape
    part = (slice(row, rows - STEP_PX + row), slice(column, columns - STEP_PX + column))
    left, right = (
        np.ascontiguousarray(np.clip(image[part] * gain, 0, 255).astype(image.dtype))
        for image in (pair.views.left, pair.views.right)
    )
    return StereoPair(left, right)


def bad_1(disparity: np.ndarray, pair: DatasetPair, row: int, column: int) -> float:
    rows, columns = pair.views.shape
    part = (slice(row, rows - STEP_PX + row), slice(column, columns - STEP_PX + column))
    error = np.abs(disparity - pair.truth_px[part])[pair.scored[part]]
    return 100.0 * float(np.mean(~(error <= 1.0)))


def run(system: ExpertSystem, pair: StereoPair, previous: Decision | None) -> tuple[Decision, np.ndarray, float]:
    begun = time.process_time()
    result = system.reconstruct(pair, previous=previous)
    return result.decision, result.disparity_px, time.process_time() - begun


def fitted(pair: StereoPair, like: StereoPair) -> StereoPair | None:
    """Cut a pair to the size of another; None where it is smaller or of another kind."""
    if pair.left.ndim != like.left.ndim or any(a < b for a, b in zip(pair.left.shape, like.left.shape, strict=True)):
        return None
    rows, columns = like.left.shape[:2]
    return StereoPair(*(np.ascontiguousarray(image[:rows, :columns]) for image in (pair.left, pair.right)))


def main() -> None:
    pairs = development_pairs(__doc__)
    systems = {profile: ExpertSystem(profile=profile) for profile in PROFILES}
    print(f"{'pair':26s}{'followed by':14s}{'change':>8s}{'levels':>8s}" + "".join(
        f"{profile + ' cold':>18s}{'warm':>16s}" for profile in PROFILES
    ))  # fmt: skip
    run(systems["fast"], view(pairs[0], 0, 0), None)
    for number, pair in enumerate(pairs):
        first, whole = view(pair, 0, 0), of_another_scene(pairs, number)
        other = fitted(StereoPair(whole.views.left, whole.views.right), first)
        followers = [("itself aside", view(pair, STEP_PX, STEP_PX)), ("itself darker", view(pair, STEP_PX, 0, 0.9))]
        followers += [] if other is None else [("another", other)]
        for name, then in followers:
            change = change_dn(thumbnail(first.left), thumbnail(then.left))
            line = f"{pair.name[-25:]:26s}{name:14s}{change[0]:8.1f}{change[1]:8.1f}"
            for system in systems.values():
                before, _, _ = run(system, first, None)
                for previous in (None, before):
                    decision, disparity, seconds = run(system, then, previous)
                    took = "*" if any(finding.name == "scene-continues" for finding in decision.findings) else ""
                    error = (
                        ""
                        if name == "another"
                        else f"{bad_1(disparity, pair, STEP_PX, STEP_PX * (name[-1] == 'e')):7.2f}"
                    )
                    density = 100.0 * float(np.isfinite(disparity).mean())
                    line += f"{1e3 * seconds:8.0f}{error or f'({density:.0f})':>7s}{took:1s}"
            print(line, flush=True)


if __name__ == "__main__":
    main()
