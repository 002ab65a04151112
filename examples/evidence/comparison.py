"""What the evidence about correction shares: pairs, matchers, errors, and a table with intervals.

Each script names some distortions and some corrections; `compare` runs every correction before every matcher on every
distorted pair and prints the mean bad-1 in % (missing counted as wrong, non-occluded pixels). Behind it stands the
mean difference from no correction with the 95 % interval of a bootstrap over scenes: pairs of one scene are drawn
together.

    TERREX_DATA=FOLDER python examples/evidence/<family>.py [--every 3] [--terrain 2]
                                     [--matchers sgbm own block] [--only KIND ...]
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modules.catalog import operators, probes
from modules.formats.datasets import read_index
from modules.measurement.sample import Sample
from modules.operator import OperatorError
from modules.simulation import REFERENCE_DISTORTIONS, TerrainParams, render_terrain
from modules.simulation.distortions import scale_distortion
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.types import DisparityRange, FloatImage, Image, Mask, Matching, Views

Step = tuple[str, Mapping[str, Any]]  # operator and parameters
Steps = Sequence[Step]

MATCHERS: Mapping[str, Step] = {
    "sgbm": ("matching.semi_global_block_match", {"mode": "3way", "block_px": 5}),
    "own": ("matching.semi_global_match", {}),
    "block": ("matching.block_match", {}),
}
CHECKS: Steps = (("matching.check_left_right", {}), ("matching.remove_speckles", {}))
ALIGN = "align as measured"  # a step: rows are aligned by what the pair's own matches say
BAD_PX = 1.0
RESAMPLES = 2000
TERRAIN_NDISP = 80  # holds the nearest ground of the rendered pairs


@dataclass(frozen=True)
class Case:
    """A pair with truth; `group` names its scene."""

    name: str
    group: str
    views: Views
    truth_px: FloatImage
    scored: Mask
    ndisp: int
    differs: bool = False


def cases(folder: Path, every: int, terrain: int, differing: bool = False) -> Iterator[Case]:
    """Yield every N-th development pair, and rendered terrains.

    Parameters
    ----------
    folder : Path
        Holds the INDEX.json of the development pairs.
    every, terrain : int
        Take every N-th pair, and this many terrains.
    differing : bool
        Take the pairs that differ radiometrically by themselves instead of the others; no terrain.
    """
    chosen = [pair for pair in read_index(folder, "dev") if pair.differs == differing]
    for pair in chosen[::every]:
        assert pair.truth_px is not None
        assert pair.scored is not None
        yield Case(pair.name, pair.group, pair.views, pair.truth_px, pair.scored, pair.ndisp, pair.differs)
    for seed in range(0 if differing else terrain):
        made = render_terrain(TerrainParams(seed=400 + seed, roll_deg=3.0, pitch_deg=-5.0))
        scored = np.isfinite(made.disparity_px) & ~made.occluded
        views = Views(made.left, made.right)
        yield Case(f"terrain {seed}", f"terrain {seed}", views, made.disparity_px, scored, TERRAIN_NDISP)


@dataclass(frozen=True)
class Both:
    """A distortion of both images, each with noise of its own."""

    sensor: SensorParams


Distortion = SensorParams | Both | str | float


def distort(views: Views, distortion: Distortion, seed: int) -> Views:
    """Return the views with a distortion of the right image, or of both.

    A reference one by name, `dark x0.5` for half of it; parameters of the sensor; or the share of stuck pixels, beside
    which one column and one row in 200 are at half brightness.
    """
    if isinstance(distortion, Both):
        noisy = [
            apply_sensor(image, distortion.sensor, seed + k) for k, image in ((1000, views.left), (0, views.right))
        ]
        return views.with_images(*noisy)
    if isinstance(distortion, float):
        return views.with_images(views.left, stick(views.right, distortion, seed))
    if isinstance(distortion, str):
        name, _, strength = distortion.partition(" x")
        distortion = scale_distortion(REFERENCE_DISTORTIONS[name], float(strength or 1))
    return views.with_images(views.left, apply_sensor(views.right, distortion, seed))


def stick(image: Image, share: float, seed: int) -> Image:
    """Return the image with hot and dead pixels and half-bright lines."""
    random = np.random.default_rng(seed)
    broken = image.copy()
    height, width = image.shape[:2]
    for axis, length in ((1, width), (0, height)):
        lines = random.choice(np.arange(2, length - 2), max(1, length // 200), replace=False)
        np.moveaxis(broken, axis, 0)[lines] //= 2
    for level in (0, np.iinfo(image.dtype).max):
        broken[random.random((height, width)) < share / 2] = level
    return broken


def correct(views: Views, steps: Steps) -> Views:
    """Run operators of correction; a pair that one refuses stays as it was before it."""
    for name, values in steps:
        if name == ALIGN:
            name, values = "correction.align_rows", alignment(views)
        operator = operators()[name]
        try:
            views = operator.function(views, operator.params(**values))
        except OperatorError:
            continue
    return views


def alignment(views: Views) -> Mapping[str, float]:
    """Return the parameters of `correction.align_rows` that the matches of a pair give; none without a fit."""
    fact: Any = probes()["measurement.row_alignment"].function(Sample(views))[0]
    if fact.offset_px is None:
        return {}
    return {"offset_px": fact.offset_px, "roll_deg": fact.roll_deg, "row_scale": fact.scale}


def bad_1(case: Case, views: Views, matcher: str) -> float:
    """Return the share of scored pixels that are missing or wrong by more than 1 px, %."""
    state = Matching(views, DisparityRange(0, case.ndisp))
    for name, values in (MATCHERS[matcher], *CHECKS):
        operator = operators()[name]
        state = operator.function(state, operator.params(**values))
    assert state.disparity is not None
    error = np.abs(state.disparity.disparity_px - case.truth_px)[case.scored]
    return 100.0 * float(np.mean(~(error <= BAD_PX)))


def interval(differences: Sequence[float], groups: Sequence[str]) -> tuple[float, float, float]:
    """Return the mean difference and the 95 % interval of a bootstrap over groups."""
    names = sorted(set(groups))
    sums = np.array([sum(d for d, g in zip(differences, groups, strict=True) if g == name) for name in names])
    counts = np.array([list(groups).count(name) for name in names])
    drawn = np.random.default_rng(0).integers(0, len(names), (RESAMPLES, len(names)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.percentile(means, (2.5, 97.5))
    return float(np.mean(differences)), float(low), float(high)


def arguments(purpose: str | None) -> argparse.Namespace:
    """Read the command line that all scripts share."""
    parser = argparse.ArgumentParser(description=(purpose or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--every", type=int, default=3, help="take every N-th development pair")
    parser.add_argument("--terrain", type=int, default=2, help="rendered terrains beside them")
    parser.add_argument("--matchers", nargs="+", choices=tuple(MATCHERS), default=["sgbm", "own"])
    parser.add_argument("--only", nargs="+", metavar="KIND", help="distortions to take; all by default")
    given = parser.parse_args()
    if given.data is None:
        parser.error("name the folder of the pairs with --data, or set TERREX_DATA")
    return given


def compare(
    given: argparse.Namespace,
    distortions: Mapping[str, Distortion],
    corrections: Mapping[str, Steps],
    differing: bool = False,
) -> None:
    """Print one table per matcher and distortion: the error of every correction, and what it changes."""
    errors: dict[tuple[str, str, str], list[float]] = {}
    groups: list[str] = []
    distortions = {kind: value for kind, value in distortions.items() if not given.only or kind in given.only}
    if not distortions:
        raise SystemExit(f"--only {' '.join(given.only)} names none of the distortions")
    corrections = {"none": (), **corrections}
    for number, case in enumerate(cases(given.data, given.every, given.terrain, differing)):
        groups.append(case.group)
        for kind, distortion in distortions.items():
            views = distort(case.views, distortion, seed=number)
            for name, steps in corrections.items():
                corrected = correct(views, steps)
                for matcher in given.matchers:
                    errors.setdefault((matcher, kind, name), []).append(bad_1(case, corrected, matcher))
    print(f"mean bad-1 in % over {len(groups)} pairs of {len(set(groups))} scenes")
    for matcher in given.matchers:
        for kind in distortions:
            print(f"\n{matcher}, {kind}")
            plain = errors[matcher, kind, "none"]
            for name in corrections:
                own = errors[matcher, kind, name]
                mean, low, high = interval([a - b for a, b in zip(own, plain, strict=True)], groups)
                change = "" if name == "none" else f"  {mean:+7.2f}  [{low:+7.2f}, {high:+7.2f}]"
                print(f"  {name:40s} {np.mean(own):7.2f}{change}")
