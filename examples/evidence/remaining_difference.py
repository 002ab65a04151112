"""Print whether another cost or window helps a matcher where the images differ after the correction, too.

The evidence behind no rule of the matching stage asking for the remaining radiometric difference: the rules correct
the pair for the matcher, and each configuration of it answers. Mean bad-1 (missing counted as wrong) and wrong among
valid in %, non-occluded pixels, and the mean error of the right ones in px; then the difference of bad-1 from the
default and its 95 % interval (bootstrap over scenes). `itself` are the pairs that differ by themselves, by exposure or
lamps; `where` groups all by what the rules find.

    TERREX_DATA=FOLDER python examples/evidence/remaining_difference.py [--every 3] [--terrain 2]
                                     [--matchers sgbm own] [--only KIND ...]
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from comparison import BAD_PX, CHECKS, MATCHERS, Case, arguments, cases, correct, distort, interval
from radiometric_pairs import chosen, system_before

from modules.catalog import operators
from modules.types import DisparityRange, Matching, Views

KINDS = ("clean", "dark", "clipped", "curve", "vignette", "local", "local x2", "combined")
ITSELF = "itself"
Errors = tuple[float, float, float]
FINDINGS = ("light-uneven", "light-patchy", "clipped-differently", "exposure-differs", "response-differs")
CONFIGURATIONS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "own": {
        "census": {"cost": "census"},
        "census 7x7": {"cost": "census", "census": "7x7"},
        "hybrid, 5x5": {"census": "5x5"},
        "ternary census": {"cost": "ternary_census"},
        "derivatives": {"cost": "sobel"},
        "window 7": {"window_px": 7},
        "smooth 1.0": {"smooth_px": 1.0},
        "P2 whatever the gray": {"p1_decay_per_dn": 0.0, "p2_decay_per_dn": 0.0, "p2": 40.0},
        "no intensities in subpx": {"subpixel": "equiangular"},
    },
    "sgbm": {
        "cap 47": {"prefilter_cap": 47},
        "cap 31": {"prefilter_cap": 31},
        "cap 23": {"prefilter_cap": 23},
        "cap 15": {"prefilter_cap": 15},
        "block 7": {"block_px": 7},
        "block 9": {"block_px": 9},
        "penalties x2": {"p1_factor": 16.0, "p2_factor": 96.0},
        "gray": {"colour": False},
        "uniqueness 5": {"uniqueness_percent": 5},
    },
}


def errors_of(case: Case, views: Views, matcher: str, values: Mapping[str, Any]) -> Errors:
    """Return bad-1 and wrong among valid, %, and the mean error of the right ones, px, of one configuration."""
    state = Matching(views, DisparityRange(0, case.ndisp))
    name, usual = MATCHERS[matcher]
    for step, parameters in ((name, {**usual, **values}), *CHECKS):
        state = operators()[step].function(state, operators()[step].params(**parameters))
    assert state.disparity is not None
    error = np.abs(state.disparity.disparity_px - case.truth_px)[case.scored]
    good, valid = error <= BAD_PX, np.isfinite(error)
    return 100.0 * float(np.mean(~good)), 100.0 * float(np.mean(~good[valid])), float(np.mean(error[good]))


def seen(folder: Path, every: int, terrain: int, only: list[str] | None) -> Iterator[tuple[str, Case, Views]]:
    """Yield the kind of difference, the pair and its views as the cameras would see them."""
    for number, case in enumerate(cases(folder, every, terrain)):
        for kind in KINDS:
            if not only or kind in only:
                yield kind, case, distort(case.views, kind, seed=number)
    if not only or ITSELF in only:
        for case in cases(folder, 1, 0, differing=True):
            yield ITSELF, case, case.views


def show(title: str, groups: list[str], rows: list[dict[str, Errors]]) -> None:
    """Print the errors of every configuration over some pairs."""
    print(f"\n{title}: {len(rows)} pairs of {len(set(groups))} scenes")
    for name in rows[0]:
        bad, wrong, px = np.mean([row[name] for row in rows], axis=0)
        mean, low, high = interval([row[name][0] - row["default"][0] for row in rows], groups)
        change = "" if name == "default" else f"  {mean:+7.2f}  [{low:+7.2f}, {high:+7.2f}]"
        print(f"  {name:24s} {bad:7.2f} {wrong:7.2f} {px:7.3f}{change}")


def main() -> None:
    given = arguments(__doc__)
    found: dict[tuple[str, str], list[tuple[str, dict[str, Errors]]]] = {}
    for matcher in given.matchers:
        system = system_before(matcher)
        for kind, case, views in seen(given.data, given.every, given.terrain, given.only):
            steps, findings = chosen(system, views, case.ndisp)
            corrected = correct(views, steps)
            configurations = {"default": {}, **CONFIGURATIONS[matcher]}
            row = {name: errors_of(case, corrected, matcher, values) for name, values in configurations.items()}
            told = [f"where {finding}" for finding in FINDINGS if finding in findings] or ["where none of these"]
            for group in (kind, *told):
                found.setdefault((matcher, group), []).append((case.group, row))
    for (matcher, kind), rows in sorted(found.items()):
        show(f"{matcher}, {kind}", [group for group, _ in rows], [row for _, row in rows])


if __name__ == "__main__":
    main()
