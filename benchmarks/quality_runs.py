"""Run fixed configurations over pairs with truth and keep what calibration and scores are fitted to.

    TERREX_DATA=... python -m benchmarks.quality_runs [--every N] [--full] [--cache build/quality]

One file per pair and distortion, by default clean and three of the nine distortions in turn: for every configuration
of `expert/evaluate/grid.yaml`, and for some after a median, its error over all scored pixels, and on a grid of pixels
the evidence (`modules.primitives.agreement`) with the true error. Beside them maps with patches that are wrong, which
no matcher would make, and pairs that cannot match. Files that are there are kept, so that a run that was stopped goes
on, and refitting needs no matching. Delete the folder when an operator has changed.
"""

from __future__ import annotations

import argparse
import os
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from expert.evaluate.grid import fixed_grid
from modules.formats.datasets import read_index
from modules.matching.median_filter import MedianFilterParams, median_filter
from modules.primitives.agreement import SCALES, gather_evidence
from modules.simulation import TerrainParams, render_terrain
from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right
from modules.types import Disparity, DisparityRange, FloatImage, Image, Invalid, Mask, Matching, Views

BAD_PX = 1.0
GRID_PIXELS = 2000  # about this many pixels of each run are kept
MEDIAN = ("robust", "align+smooth+robust", "sgbm-9")  # configurations whose maps are smoothed as well
PATCHED = ("robust", "align+robust", "sgbm-5")  # configurations whose maps get wrong patches
PATCHED_KINDS = ("clean", "noise", "combined")
FEW = (*MEDIAN, "align+robust", "sgbm-5", "block-15", "census")  # configurations where only confidence is asked
PATCH, SHIFTED = "patched", "whole"  # name such runs
PATCHES = (2, 7)  # least and most wrong patches of a map
PATCH_SHARE = (0.1, 0.33)  # least and most side of a patch, of the side of the map
SHIFTS_PX = (-8.0, -4.0, -3.0, -2.0, 2.0, 3.0, 5.0, 9.0)  # added to a patch
SHIFT_PX = np.float32(3.0)  # added to a whole map
BUMP_PX = 6.0  # standard deviation of a wavy patch
TERRAIN_SEEDS = 4
TERRAIN_KINDS = ("clean", "noise", "combined")
Wanted = Callable[[str, str], bool]  # whether a case, by name and kind, is still to be run


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


def kinds_of(number: int, full: bool) -> list[str]:
    """Return the distortions of a pair: all, or none and three others, which are other ones for the next pair."""
    kinds = [kind for kind in REFERENCE_DISTORTIONS if kind != "clean"]
    return ["clean", *(kinds if full else (kinds[(number + turn) % len(kinds)] for turn in range(0, len(kinds), 3)))]


def development_cases(folder: Path, every: int, full: bool, wanted: Wanted) -> Iterator[Case]:
    """Yield the development pairs with each wanted distortion."""
    for number, pair in enumerate(read_index(folder, "dev")):
        if number % every == 0 and pair.truth_px is not None and pair.scored is not None:
            for kind in (kind for kind in kinds_of(number, full) if wanted(f"{number:02d}", kind)):
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


def unrelated_cases(folder: Path, every: int, wanted: Wanted) -> Iterator[Case]:
    """Yield pairs that show two scenes, noise, nothing, or one pattern again and again: no disparity is right."""
    pairs = [pair for number, pair in enumerate(read_index(folder, "dev")) if number % every == 0]
    for number, pair in enumerate(pairs):
        if wanted(f"cross{number:02d}", "unrelated"):
            right = pairs[(number + len(pairs) // 2) % len(pairs)].views.right
            views = Views(pair.views.left, _fitted(right, pair.views.left))
            yield _hopeless(f"cross{number:02d}", pair.group, "unrelated", views, pair.ndisp)
    for name, kind, views in _made_up():
        if wanted(name, kind):
            yield _hopeless(name, name.rstrip("0123456789"), kind, views, 64)


def _fitted(image: Image, like: Image) -> Image:
    """Give an image the shape of another one."""
    rows, columns = like.shape[:2]
    resized = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
    if resized.ndim < like.ndim:
        resized = np.broadcast_to(resized[..., None], like.shape)
    return np.ascontiguousarray(resized)


def _made_up() -> Iterator[tuple[str, str, Views]]:
    """Yield name, kind and images of noise, waves along the rows, and nothing."""
    size = (360, 480)
    for number, (sigma, period) in enumerate(
        zip((0.0, 0.7, 1.5, 3.0, 6.0, 12.0), (6.0, 8.0, 11.0, 14.0, 19.0, 24.0), strict=True)
    ):
        source = np.random.default_rng(number)
        yield f"noise{number}", "unrelated", Views(_noise(source, size, sigma), _noise(source, size, sigma))
        wave = 128 + 60 * np.sin(2 * np.pi * np.arange(size[1] + 40) / period)
        images = [np.clip(wave[None, at : at + size[1]] + source.normal(0, 3, size), 0, 255) for at in (0, 5)]
        yield f"wave{number}", "periodic", Views(images[0].astype(np.uint8), images[1].astype(np.uint8))
    for number, sigma_dn in enumerate((0.0, 1.0, 4.0)):
        source = np.random.default_rng(number)
        images = [np.rint(128 + source.normal(0, sigma_dn, size)) for _ in range(2)]
        yield f"empty{number}", "constant", Views(images[0].astype(np.uint8), images[1].astype(np.uint8))


def _noise(source: np.random.Generator, size: tuple[int, int], sigma_px: float) -> NDArray[np.uint8]:
    values = source.normal(0.0, 1.0, size)
    if sigma_px:
        values = cv2.GaussianBlur(values, (0, 0), sigma_px)
    return np.clip(128 + 40 * values / values.std(), 0, 255).astype(np.uint8)


def _hopeless(name: str, group: str, kind: str, views: Views, count: int) -> Case:
    nothing = np.full(views.shape, np.float32(np.inf))
    return Case(name, group, kind, views, nothing, np.ones(views.shape, bool), DisparityRange(0, count))


def grid_of(shape: tuple[int, int]) -> tuple[slice, slice]:
    """Return the pixels that are kept: every n-th row and column."""
    step = max(1, round(np.sqrt(shape[0] * shape[1] / GRID_PIXELS)))
    return slice(step // 2, None, step), slice(step // 2, None, step)


def record(case: Case, state: Matching) -> dict[str, NDArray[np.generic]]:
    """Return what is kept of one run."""
    disparity = state.disparity
    assert disparity is not None
    evidence = gather_evidence(*state.views.as_seen, disparity, case.search)
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
        "edges": np.float64(evidence.edges),
        "agreement": np.float64(np.nan if evidence.agreement is None else evidence.agreement),
        "over_chance": np.float64(np.nan if evidence.over_chance is None else evidence.over_chance),
        "codes": np.stack([evidence.codes(kind)[grid].ravel() for kind in SCALES]),
        "valid": evidence.valid[grid].ravel(),
        "scored": case.scored[grid].ravel(),
        "error_px": np.clip(error[grid].ravel(), -1000, 1000).astype(np.float32),
    }


def file_of(cache: Path, name: str, kind: str) -> Path:
    """Return the file that holds the runs of a case."""
    return cache / f"{name}-{kind}.npz"


def fill(cache: Path, cases: Iterator[Case], names: tuple[str, ...]) -> None:
    """Run what the cache does not hold yet."""
    grid = fixed_grid()
    for case in cases:
        file = file_of(cache, case.name, case.kind)
        start = time.process_time()
        kept: dict[str, NDArray[np.generic]] = {"group": np.array(case.group), "kind": np.array(case.kind)}
        for name in names:
            state = grid[name].run(case.views, case.search.max_px).matching
            if state is None or state.disparity is None:
                print(f"{case.name} {case.kind} {name}: failed")
                continue
            variants = {name: state}
            if name in MEDIAN:
                variants[f"median {name}"] = median_filter(state, MedianFilterParams(size_px=5))
            if name in PATCHED and case.kind in PATCHED_KINDS:
                variants[f"{PATCH} {name}"] = replace(state, disparity=with_patches(state.disparity, file.stem))
                whole = replace(state.disparity, disparity_px=state.disparity.disparity_px + SHIFT_PX, right_px=None)
                variants[f"{PATCH} {name} {SHIFTED}"] = replace(state, disparity=whole)
            for variant, made in variants.items():
                kept |= {f"{variant}/{key}": value for key, value in record(case, made).items()}
        unfinished = file.with_suffix(".tmp.npz")
        np.savez_compressed(unfinished, **kept)
        unfinished.rename(file)
        print(f"{case.name} {case.kind}: {time.process_time() - start:.1f} s", flush=True)


def with_patches(disparity: Disparity, name: str) -> Disparity:
    """Return a map with wrong patches: scattered, shifted, wavy, or those of another place.

    What the matcher knew of the right image is dropped, and for every second map its excess.
    """
    seed = zlib.crc32(name.encode())
    source = np.random.default_rng(seed)
    values = disparity.disparity_px.copy()
    shape = values.shape
    elsewhere = np.roll(values, (shape[0] // 2, shape[1] // 3), axis=(0, 1))
    for _ in range(int(source.integers(PATCHES[0], PATCHES[1] + 1))):
        sides = [int(source.uniform(*PATCH_SHARE) * side) for side in shape]
        first = [int(source.integers(0, side - size)) for side, size in zip(shape, sides, strict=True)]
        patch = tuple(slice(at, at + size) for at, size in zip(first, sides, strict=True))
        way = source.integers(4)
        if way == 0:
            values[patch] += source.uniform(2, 20, sides).astype(np.float32)
        elif way == 1:
            values[patch] += np.float32(source.choice(SHIFTS_PX))
        elif way == 2:
            wave = cv2.GaussianBlur(source.normal(0, 1, sides), (0, 0), 6.0)
            values[patch] += (BUMP_PX * wave / wave.std() + 4.0 * np.sign(wave)).astype(np.float32)
        else:
            values[patch] = np.where(np.isfinite(values[patch]), elsewhere[patch], np.float32(np.nan))
    lost = np.isnan(values) & disparity.valid
    validity = np.where(lost, np.uint16(Invalid.NO_MATCH), disparity.validity)
    return Disparity(values, validity, excess=disparity.excess if seed % 2 else None)


def fill_cache(cache: Path, folder: Path, every: int = 1, full: bool = False) -> None:
    """Make all runs that a cache does not hold yet: images that cannot match, development pairs, terrain."""
    cache.mkdir(parents=True, exist_ok=True)

    def wanted(name: str, kind: str) -> bool:
        return not file_of(cache, name, kind).exists()

    fill(cache, unrelated_cases(folder, every, wanted), FEW)
    fill(cache, development_cases(folder, every, full, wanted), tuple(fixed_grid()))
    fill(cache, terrain_cases(TERRAIN_SEEDS, TERRAIN_KINDS, wanted), FEW)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--every", type=int, default=1, help="take every N-th pair only")
    parser.add_argument("--full", action="store_true", help="every pair with all ten distortions")
    parser.add_argument("--cache", type=Path, default=Path("build/quality"))
    args = parser.parse_args()
    if not args.data:
        raise SystemExit("no data: set TERREX_DATA or give --data FOLDER")
    fill_cache(args.cache, Path(args.data), args.every, args.full)


if __name__ == "__main__":
    main()
