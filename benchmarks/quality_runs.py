"""Run fixed configurations over pairs with truth and keep what calibration and scores are fitted to.

    TERREX_DATA=... python -m benchmarks.quality_runs [--every N] [--kinds clean noise ...] [--cache build/quality]

One file per pair and distortion: for every configuration its error over all scored pixels, and on a grid of pixels the
evidence (`modules.primitives.agreement`) with the true error. Files that are there are kept, so that a run that was
stopped goes on, and refitting needs no matching. Delete the folder when an operator has changed.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.catalog import operators
from modules.formats.datasets import read_index
from modules.measurement.row_alignment import RowAlignment, measure_row_alignment
from modules.measurement.sample import Sample
from modules.operator import OperatorError
from modules.primitives.agreement import SCALES, gather_evidence
from modules.simulation import TerrainParams, render_terrain
from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right
from modules.types import DisparityRange, FloatImage, Mask, Matching, Views

BAD_PX = 1.0
GRID_PIXELS = 4000  # about this many pixels of each run are kept
CHECKS = ("matching.check_left_right", "matching.remove_speckles")
MEDIAN = ("matching.median_filter", {})
SGM, SGBM = "matching.semi_global_match", "matching.semi_global_block_match"
Wanted = Callable[[str, str], bool]  # whether a case, by name and kind, is still to be run
ALIGN = ("align", {})  # by the measured row misalignment
HISTOGRAM = ("correction.match_histograms", {"channels": "each"})
MOVED = "sgm"  # configuration whose maps are moved
WHOLE_PX = 3.0  # added to a whole map
BLOCK_PX = 48  # side of the blocks that are moved
OFFSETS_PX = (0.0, 3.0, 0.0, -4.0, 0.0, 7.0, 0.0)  # added to the blocks in turn; every pixel of one more gets its own
TERRAIN_SEEDS = 4
TERRAIN_KINDS = ("clean", "dark", "vignette", "noise", "blur", "combined")

CONFIGURATIONS: dict[str, tuple[tuple[str, dict], ...]] = {
    "sgm": ((SGM, {"p1": 12.0, "p2": 70.0}), MEDIAN),
    "sgm window 9": ((SGM, {"p1": 12.0, "p2": 70.0, "window_px": 9}), MEDIAN),
    "sgm census": ((SGM, {"cost": "census", "p1": 12.0, "p2": 70.0}),),
    "align, sgm": (ALIGN, (SGM, {"p1": 12.0, "p2": 70.0}), MEDIAN),
    "align, sgm window 9": (ALIGN, (SGM, {"p1": 12.0, "p2": 80.0, "window_px": 9}), MEDIAN),
    "smooth, sgm window 9": (
        ("correction.denoise_gaussian", {"sigma_px": 0.8}),
        (SGM, {"p1": 12.0, "p2": 80.0, "window_px": 9}),
        MEDIAN,
    ),
    "sgbm 5": ((SGBM, {}),),
    "sgbm 9": ((SGBM, {"block_px": 9}),),
    "histogram, sgbm 5": (HISTOGRAM, (SGBM, {})),
    "align, histogram, sgbm 5": (ALIGN, HISTOGRAM, (SGBM, {})),
    "local contrast, sgbm 5": (("correction.normalise_local_contrast", {}), (SGBM, {})),
    "block 15": (("matching.block_match", {}),),
}


@dataclass(frozen=True)
class Case:
    """A pair as it is matched, with its truth (NaN: unknown) and the scored pixels."""

    name: str
    group: str
    kind: str
    views: Views
    truth_px: FloatImage
    scored: Mask
    search: DisparityRange


def development_cases(folder: Path, every: int, kinds: tuple[str, ...], wanted: Wanted) -> Iterator[Case]:
    """Yield the development pairs with each wanted distortion."""
    for number, pair in enumerate(read_index(folder, "dev")):
        if number % every == 0 and pair.truth_px is not None and pair.scored is not None:
            for kind in (kind for kind in kinds if wanted(f"{number:02d}", kind)):
                views = distort_right(pair.views, kind, seed=number)
                search = DisparityRange(0, pair.ndisp)
                yield Case(f"{number:02d}", pair.group, kind, views, pair.truth_px, pair.scored, search)


def terrain_cases(seeds: int, kinds: tuple[str, ...], wanted: Wanted) -> Iterator[Case]:
    """Yield rendered terrains with each wanted distortion."""
    for seed in range(seeds):
        missing = [kind for kind in kinds if wanted(f"terrain{seed}", kind)]
        if not missing:
            continue
        made = render_terrain(TerrainParams(seed=seed, roll_deg=3.0 * seed - 4.0, pitch_deg=-8.0 + 3.0 * seed))
        for kind in missing:
            views = distort_right(Views(made.left, made.right), kind, seed=seed)
            truth = made.disparity_px
            yield Case(f"terrain{seed}", f"terrain{seed}", kind, views, truth, made.nonocc, DisparityRange(0, 64))


def unrelated_cases(folder: Path, every: int) -> Iterator[Case]:
    """Yield pairs that show two scenes, noise, or one pattern again and again: no disparity of theirs is right."""
    pairs = [pair for number, pair in enumerate(read_index(folder, "dev")) if number % every == 0]
    for number, pair in enumerate(pairs):
        other = pairs[(number + len(pairs) // 2) % len(pairs)]
        rows, columns = pair.views.shape
        right = cv2.resize(other.views.right, (columns, rows), interpolation=cv2.INTER_AREA)
        right = right if pair.views.left.ndim == right.ndim else np.broadcast_to(right[..., None], (rows, columns, 3))
        views = Views(pair.views.left, np.ascontiguousarray(right))
        yield _hopeless(f"cross{number:02d}", pair.group, "unrelated", views, pair.ndisp)
    for number in range(6):
        source = np.random.default_rng(number)
        size = (360, 480)
        sigma = (0.0, 0.7, 1.5, 3.0, 6.0, 12.0)[number]
        images = [_noise(source, size, sigma) for _ in range(2)]
        yield _hopeless(f"noise{number}", "noise", "unrelated", Views(images[0], images[1]), 64)
        period = (6.0, 8.0, 11.0, 14.0, 19.0, 24.0)[number]
        wave = 128 + 60 * np.sin(2 * np.pi * np.arange(size[1] + 40) / period)
        images = [np.clip(wave[None, at : at + size[1]] + source.normal(0, 3, size), 0, 255) for at in (0, 5)]
        views = Views(images[0].astype(np.uint8), images[1].astype(np.uint8))
        yield _hopeless(f"wave{number}", "wave", "periodic", views, 64)


def _noise(source: np.random.Generator, size: tuple[int, int], sigma_px: float) -> NDArray[np.uint8]:
    values = source.normal(0.0, 1.0, size)
    if sigma_px:
        values = cv2.GaussianBlur(values, (0, 0), sigma_px)
    return np.clip(128 + 40 * values / values.std(), 0, 255).astype(np.uint8)


def _hopeless(name: str, group: str, kind: str, views: Views, count: int) -> Case:
    nothing = np.full(views.shape, np.float32(np.inf))
    return Case(name, group, kind, views, nothing, np.ones(views.shape, bool), DisparityRange(0, count))


def misalignment(views: Views) -> RowAlignment:
    """Return the measured row misalignment of a pair."""
    return measure_row_alignment(Sample(views))[0]


def run(steps: tuple[tuple[str, dict], ...], case: Case, rows: RowAlignment) -> Matching:
    """Run the corrections, the matcher, the checks and what follows them."""
    catalog = operators()
    state = Matching(case.views, case.search)
    for name, values in steps:
        if name == ALIGN[0]:
            if rows.max_abs_px is None or rows.max_abs_px < 0.3 or rows.count < 50:
                continue
            name, values = (
                "correction.align_rows",
                {"offset_px": rows.offset_px, "roll_deg": rows.roll_deg, "row_scale": rows.scale},
            )
        operator = catalog[name]
        if operator.stage == "correction":
            state = replace(state, views=operator.function(state.views, operator.params(**values)))
        else:
            state = operator.function(state, operator.params(**values))
        if operator.slot == "matcher":
            for check in CHECKS:
                state = catalog[check].function(state, catalog[check].params())
    return state


def grid_of(shape: tuple[int, int]) -> tuple[slice, slice]:
    """Return the pixels that are kept: every n-th row and column."""
    step = max(1, round(np.sqrt(shape[0] * shape[1] / GRID_PIXELS)))
    return slice(step // 2, None, step), slice(step // 2, None, step)


def record(case: Case, state: Matching) -> dict[str, NDArray[np.generic]]:
    """Return what is kept of one run."""
    disparity = state.disparity
    assert disparity is not None
    evidence = gather_evidence(state.views.left, state.views.right, disparity)
    grid = grid_of(case.scored.shape)
    error = disparity.disparity_px - case.truth_px
    error[~case.scored] = np.nan
    scored = error[case.scored]
    valid = np.isfinite(disparity.disparity_px[case.scored])
    good = np.abs(scored) <= BAD_PX
    return {
        "bad_percent": np.float64(100 * np.mean(~good)),
        "wrong_percent": np.float64(100 * np.mean(~good[valid]) if valid.any() else 0.0),
        "density_percent": np.float64(100 * np.mean(valid)),
        "density": np.float64(evidence.density),
        "codes": np.stack([evidence.codes[kind][grid].ravel() for kind in SCALES]),
        "valid": evidence.valid[grid].ravel(),
        "scored": case.scored[grid].ravel(),
        "error_px": np.clip(error[grid].ravel(), -1000, 1000).astype(np.float32),
    }


def file_of(cache: Path, name: str, kind: str) -> Path:
    """Return the file that holds the runs of a case."""
    return cache / f"{name}-{kind}.npz"


def fill(cache: Path, cases: Iterator[Case]) -> None:
    """Run what the cache does not hold yet."""
    for case in cases:
        file = file_of(cache, case.name, case.kind)
        if file.exists():
            continue
        start = time.process_time()
        rows = misalignment(case.views)
        kept: dict[str, NDArray[np.generic]] = {"group": np.array(case.group), "kind": np.array(case.kind)}
        for name, steps in CONFIGURATIONS.items():
            try:
                made = record(case, run(steps, case, rows))
            except OperatorError as error:
                print(f"{case.name} {case.kind} {name}: {error}")
                continue
            kept |= {f"{name}/{key}": value for key, value in made.items()}
        unfinished = file.with_suffix(".tmp.npz")
        np.savez_compressed(unfinished, **kept)
        unfinished.rename(file)
        print(f"{case.name} {case.kind}: {time.process_time() - start:.1f} s", flush=True)


def fill_moved(cache: Path, cases: Iterator[Case]) -> None:
    """Add maps of which blocks are moved away from the truth: what only the images, or only the neighbours, tell."""
    for case in cases:
        state = run(CONFIGURATIONS[MOVED], case, misalignment(case.views))
        assert state.disparity is not None
        for variant, added in (("moved", blocks(case.views.shape)), ("shifted", np.float32(WHOLE_PX))):
            moved = replace(
                state.disparity, disparity_px=state.disparity.disparity_px + added, right_px=None, excess=None
            )
            kept = {"group": np.array(case.group), "kind": np.array("moved")}
            kept |= {f"{MOVED}/{key}": value for key, value in record(case, replace(state, disparity=moved)).items()}
            np.savez_compressed(file_of(cache, f"{variant}{case.name}", "moved"), **kept)


def blocks(shape: tuple[int, int]) -> FloatImage:
    """Return what is added to the disparity: nothing or one of the offsets by blocks, or another number per pixel."""
    rows, columns = np.indices(shape) // BLOCK_PX
    turn = (rows * 3 + columns) % (len(OFFSETS_PX) + 1)
    scattered = np.random.default_rng(0).uniform(2, 20, shape)
    added = np.select([turn == index for index in range(len(OFFSETS_PX))], OFFSETS_PX, scattered)
    return added.astype(np.float32)


def fill_cache(
    cache: Path, folder: Path, every: int = 1, kinds: tuple[str, ...] = tuple(REFERENCE_DISTORTIONS)
) -> None:
    """Make all runs that a cache does not hold yet: unrelated images, moved maps, development pairs, terrain."""
    cache.mkdir(parents=True, exist_ok=True)

    def wanted(name: str, kind: str) -> bool:
        return not file_of(cache, name, kind).exists()

    def unmoved(name: str, _: str) -> bool:
        return wanted(f"shifted{name}", "moved")

    fill(cache, unrelated_cases(folder, every))
    fill_moved(cache, development_cases(folder, every, ("clean",), unmoved))
    fill(cache, development_cases(folder, every, kinds, wanted))
    fill(cache, terrain_cases(TERRAIN_SEEDS, TERRAIN_KINDS, wanted))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--every", type=int, default=1, help="take every N-th pair only")
    parser.add_argument("--kinds", nargs="+", default=list(REFERENCE_DISTORTIONS))
    parser.add_argument("--cache", type=Path, default=Path("build/quality"))
    args = parser.parse_args()
    if not args.data:
        raise SystemExit("no data: set TERREX_DATA or give --data FOLDER")
    fill_cache(args.cache, Path(args.data), args.every, tuple(args.kinds))


if __name__ == "__main__":
    main()
