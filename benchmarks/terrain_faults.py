"""Put faults into rendered terrain and say what is told, what is repaired and what the map is worth then.

    python -m benchmarks.terrain_faults [--seeds 6] [--first 0] [--faults "doffs -4,wrong sign"]

Roll and pitch of the wrong sign or in radians, a disparity offset (doffs), a sky that leaks (a response curve in the
right camera) and patches of the right image moved by 10 px, which would make spikes. Printed are, over the seeds: how
many have the finding that belongs to the fault in the end, how many were run again for it, the median elevation error
within 6 m, and the tilt of the ground; a map levelled by its ground plane is left out of the error. A disparity offset
that brings points nearer looks like ground of another slope and height: no fact of one pair tells it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.terrain import pair_of, rendered, score
from expert import ExpertSystem, StereoPair
from expert.result import Result
from modules.simulation.terrain import RenderedPair
from modules.types import Attitude

PATCHES, PATCH_PX, MOVED_PX = 60, 15, 10


@dataclass(frozen=True)
class Fault:
    """How to make a fault, the finding that tells it, the rules that repair it."""

    make: Callable[[RenderedPair, int], StereoPair]
    findings: tuple[str, ...]
    repairs: tuple[str, ...]


def clean(made: RenderedPair, seed: int) -> StereoPair:
    return pair_of(made, "clean", seed, attitude=True)


def wrong_sign(made: RenderedPair, seed: int) -> StereoPair:
    true = made.attitude
    return replace(clean(made, seed), attitude=Attitude(-true.roll_rad, -true.pitch_rad, true.yaw_rad))


def radians(made: RenderedPair, seed: int) -> StereoPair:
    true = made.attitude
    return replace(
        clean(made, seed), attitude=Attitude(math.radians(true.roll_rad), math.radians(true.pitch_rad), true.yaw_rad)
    )


def offset(doffs_px: float) -> Callable[[RenderedPair, int], StereoPair]:
    def make(made: RenderedPair, seed: int) -> StereoPair:
        return replace(clean(made, seed), calibration=replace(made.calibration, doffs_px=doffs_px))

    return make


def sky(made: RenderedPair, seed: int) -> StereoPair:
    return pair_of(made, "curve", seed, attitude=True)


def spikes(made: RenderedPair, seed: int) -> StereoPair:
    rng = np.random.default_rng(seed)
    right = made.right.copy()
    rows = rng.integers(made.right.shape[0] // 2, made.right.shape[0] - PATCH_PX, PATCHES)
    columns = rng.integers(MOVED_PX, made.right.shape[1] - PATCH_PX, PATCHES)
    for row, column in zip(rows, columns, strict=True):
        patch = made.right[row : row + PATCH_PX, column : column + PATCH_PX]
        right[row : row + PATCH_PX, column - MOVED_PX : column - MOVED_PX + PATCH_PX] = patch
    return replace(clean(made, seed), right=right)


OFFSET = (("points-behind-camera",), ("REC082",))
FAULTS = {
    "none": Fault(clean, (), ()),
    "wrong sign": Fault(wrong_sign, ("attitude-sign-doubtful", "attitude-not-used"), ("REC041",)),
    "radians": Fault(radians, ("attitude-unit-doubtful",), ()),
    **{f"doffs {px:g}": Fault(offset(px), *OFFSET) for px in (-8.0, -4.0, -2.5, 2.5, 4.0)},
    "sky": Fault(sky, ("sky-leaked",), ("REC081", "REC044")),
    "spikes": Fault(spikes, ("terrain-spiky",), ("REC045",)),
}


def repaired(result: Result, rules: tuple[str, ...]) -> bool:
    """Return whether a trial of the terrain was run again because of one of the rules."""
    return any(rule in trial.answer for trial in result.decision.trials for rule in rules)


def error_cm(made: RenderedPair, result: Result) -> float:
    """Return the median elevation error, cm; NaN where the level of the map is another one than that of the truth."""
    if result.elevation is None or any(finding.name == "attitude-not-used" for finding in result.decision.findings):
        return math.nan
    return score(made, result.elevation).median_cm


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--faults", default=",".join(FAULTS))
    args = parser.parse_args()
    system = ExpertSystem()
    made = {seed: rendered(seed) for seed in range(args.first, args.first + args.seeds)}
    print(f"{'fault':14s}{'told':>8s}{'repaired':>10s}{'median cm':>11s}{'tilt deg':>10s}")
    for name in args.faults.split(","):
        fault = FAULTS[name]
        results = {seed: system.reconstruct(fault.make(pair, seed)) for seed, pair in made.items()}
        told = sum(any(f.name in fault.findings for f in r.decision.findings) for r in results.values())
        again = sum(repaired(r, fault.repairs) for r in results.values())
        errors = [error_cm(made[seed], result) for seed, result in results.items()]
        tilts = [
            float(record.fields["plane_tilt_deg"])
            for result in results.values()
            for record in result.decision.facts
            if record.template == "terrain_quality" and "plane_tilt_deg" in record.fields
        ]
        middle = float(np.nanmedian(errors)) if np.isfinite(errors).any() else math.nan
        print(
            f"{name:14s}{told:5d}/{len(made)}{again:8d}/{len(made)}{middle:11.2f}{np.median(tilts):10.1f}", flush=True
        )


if __name__ == "__main__":
    main()
