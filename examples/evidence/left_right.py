"""Print what the left-right check rejects rightly and wrongly, and what is won by keeping strong pixels of a surface.

The evidence behind MAT050, for each half of the scenes: bad-1 in % (missing counted as wrong) and wrong among valid in
% where both cameras see, and in brackets the latter everywhere. The rest of the plan is the shipped one, with the limit
of MAT041 on the confidence. Below, the share of right ones among the pixels that the check rejects where both see.

    TERREX_DATA=FOLDER python examples/evidence/left_right.py [--every 1]
"""

from __future__ import annotations

import numpy as np
from development import development_pairs

from modules.catalog import operators
from modules.formats.datasets import DatasetPair
from modules.simulation.distortions import distort_right
from modules.types import Disparity, DisparityRange, Matching

KINDS = ("clean", "noise", "combined")
CONSISTENCY = "matching.check_left_right"
CHECKS: dict[str, dict] = {
    "check alone": {},
    "tolerance 3 px": {"tolerance_px": 3.0},
    "excess 0.1": {"strong_excess": 0.1},
    "excess 0.2": {"strong_excess": 0.2},
    "excess 0.4": {"strong_excess": 0.4},
}
AFTER = (
    ("matching.remove_speckles", {}),
    ("matching.median_filter", {}),
    ("matching.estimate_confidence", {"least": 0.15}),
)


def score(disparity: Disparity, pair: DatasetPair) -> tuple[float, float, float]:
    """Return bad-1 and wrong among valid where the right camera sees, and the latter everywhere, %."""
    assert pair.truth_px is not None
    assert pair.scored is not None
    error = np.abs(disparity.disparity_px - pair.truth_px)
    good, known = error <= 1.0, np.isfinite(error)
    seen = pair.scored
    return (
        100.0 * float(1.0 - good[seen].mean()),
        100.0 * float(1.0 - good[known & seen].mean()),
        100.0 * float(1.0 - good[known].mean()),
    )


def right_ones(before: Matching, after: Matching, pair: DatasetPair) -> tuple[int, int]:
    """Return how many of the pixels that a check rejected where both cameras see were right, and how many they are."""
    assert before.disparity is not None
    assert after.disparity is not None
    rejected = before.disparity.valid & ~after.disparity.valid & pair.scored
    right = np.abs(before.disparity.disparity_px - pair.truth_px) <= 1.0
    return int(np.count_nonzero(rejected & right)), int(np.count_nonzero(rejected))


def main() -> None:
    catalog = operators()

    def apply(state: Matching, name: str, values: dict) -> Matching:
        return catalog[name].function(state, catalog[name].params(**values))

    pairs = development_pairs(__doc__, every=1)
    groups = sorted({pair.group for pair in pairs})
    rejected: dict[tuple[int, str], list[tuple[int, int]]] = {}
    found: dict[tuple[int, str, str], list[tuple[float, float, float]]] = {}
    for number, pair in enumerate(pairs):
        half = groups.index(pair.group) % 2
        for kind in KINDS:
            views = distort_right(pair.views, kind, seed=number)
            matched = apply(Matching(views, DisparityRange(0, pair.ndisp)), "matching.semi_global_match", {})
            for name, values in CHECKS.items():
                state = apply(matched, CONSISTENCY, values)
                if not values:
                    rejected.setdefault((half, kind), []).append(right_ones(matched, state, pair))
                for step in AFTER:
                    state = apply(state, *step)
                assert state.disparity is not None
                found.setdefault((half, kind, name), []).append(score(state.disparity, pair))
    for half in (0, 1):
        shares = [np.sum(rejected[half, kind], axis=0) for kind in KINDS]
        print(f"\nscenes of half {half}" + "".join(f"{kind:>26s}" for kind in KINDS))
        for name in CHECKS:
            means = (np.mean(found[half, kind, name], axis=0) for kind in KINDS)
            print(f"  {name:15s}" + "".join(f"{b:14.2f} {w:5.2f} ({o:.2f})" for b, w, o in means))
        print("  right ones, %  " + "".join(f"{100 * right / number:14.1f}{'':12s}" for right, number in shares))


if __name__ == "__main__":
    main()
