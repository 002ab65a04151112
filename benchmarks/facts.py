"""Simulate differences of known size and compare what the facts say: bias and spread per fact.

    TERREX_DATA=... python -m benchmarks.facts [--every N] [--seeds 2] [--write]   accuracy; --write renews the page
    python -m benchmarks.facts --time                                             CPU time per probe at two sizes

The differences are simulated in one image of development pairs whose cameras agree and of rendered terrain. The
error of a fact is what it says less what was simulated; what the real cameras differ by themselves is part of it. The
column `2 sigma` gives the share of errors within twice the uncertainty that the fact itself states.
"""

from __future__ import annotations

import argparse
import itertools
import os
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.causes import pairs_of
from benchmarks.fact_checks import CHECKS, Check, fact_of
from modules.catalog import probes
from modules.formats.datasets import read_index
from modules.measurement.sample import Sample
from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.simulation.terrain import TerrainParams, render_terrain
from modules.types import FloatImage, Mask, Views

PAGE = Path(__file__).parents[1] / "docs" / "facts_validation.md"
SIZES = ((640, 480), (1280, 960))


@dataclass
class Errors:
    """Errors of one check, and how many lay within twice the stated uncertainty."""

    values: list[float]
    within: list[bool]
    missing: int = 0


def add(errors: Errors, check: Check, views: Views, seed: int) -> None:
    """Measure one damaged pair."""
    image = getattr(views, check.side)
    damaged = check.damage(image, 1.0, seed)
    images = (views.left, damaged) if check.side == "right" else (damaged, views.right)
    fact = fact_of(views.with_images(*images), check.probe, check.side)
    value = getattr(fact, check.field)
    if value is None:
        errors.missing += 1
        return
    truth = check.truth if isinstance(check.truth, float) else check.truth(image, seed)
    error = float(value) - truth
    if check.field.endswith("direction_deg"):
        error = (error + 90) % 180 - 90
    errors.values.append(error)
    if check.sigma:
        errors.within.append(abs(error) <= 2 * getattr(fact, check.sigma))


def rendered(seeds: int) -> Iterator[Views]:
    """Yield rendered terrain."""
    for seed in range(seeds):
        made = render_terrain(TerrainParams(seed=seed, pitch_deg=-6.0))
        yield Views(made.left, made.right)


def accuracy(folder: Path | None, every: int, seeds: int) -> str:
    """Return the table of bias and spread."""
    sources: list[tuple[str, Views]] = [("rendered", views) for views in rendered(2 * seeds)]
    if folder is not None:
        sources += [("real", pair.views) for _, pair in pairs_of(folder, every)]
    table: dict[tuple[int, str], Errors] = defaultdict(lambda: Errors([], []))
    for number, (source, views) in enumerate(sources):
        for index, check in enumerate(CHECKS):
            if check.field == "cast_fraction" and views.left.ndim == 2:
                continue
            for seed in range(seeds):
                add(table[index, source], check, views, 100 * number + seed)
    lines = [
        "| fact | simulated | pairs | count | median error | 5 % | 95 % | 2 sigma |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for (index, source), errors in sorted(table.items()):
        check = CHECKS[index]
        low, middle, high = np.percentile(errors.values, (5, 50, 95)) if errors.values else (np.nan,) * 3
        within = f"{100 * np.mean(errors.within):.0f} %" if errors.within else ""
        missing = f" ({errors.missing} absent)" if errors.missing else ""
        lines.append(
            f"| `{check.probe}.{check.field}` | {check.what} | {source} | {len(errors.values)}{missing} "
            f"| {middle:.3f} | {low:.3f} | {high:.3f} | {within} |"
        )
    return "\n".join(lines)


def sky_quality(count: int) -> str:
    """Return how well the share of the sky and the horizon are told on rendered terrain."""
    found: dict[str, Errors] = {name: Errors([], []) for name in ("sky_fraction", "horizon_fraction")}
    for seed, pitch_deg in itertools.product(range(count), (-12.0, -6.0, 0.0, 6.0)):
        made = render_terrain(TerrainParams(seed=700 + seed, pitch_deg=pitch_deg))
        fact: Any = fact_of(Views(made.left, made.right), "scene", "left")
        found["sky_fraction"].values.append(fact.sky_fraction - float(made.sky.mean()))
        columns = made.sky.any(axis=0)
        if not columns.any() or fact.horizon_fraction is None:
            found["horizon_fraction"].missing += bool(columns.any())
            continue
        rows = len(made.sky) - np.argmax(made.sky[::-1, columns], axis=0)
        found["horizon_fraction"].values.append(fact.horizon_fraction - float(np.median(rows)) / len(made.sky))
    lines = ["| fact | pairs | missed | median error | 5 % | 95 % |", "|---|---|---|---|---|---|"]
    for name, errors in found.items():
        low, middle, high = np.percentile(errors.values, (5, 50, 95)) if errors.values else (np.nan,) * 3
        lines.append(
            f"| `scene.{name}` | {len(errors.values)} | {errors.missing} | {middle:.3f} | {low:.3f} | {high:.3f} |"
        )
    return "\n".join(lines)


def range_quality(folder: Path, every: int) -> str:
    """Return how often the estimated disparity range covers the true one, and how much wider it is."""
    rows: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    for number, pair in enumerate(read_index(folder, "dev")):
        if number % every or pair.truth_px is None or pair.scored is None:
            continue
        low, high = _true_range(pair.truth_px, pair.scored)
        for kind in REFERENCE_DISTORTIONS:
            fact: Any = fact_of(distort_right(pair.views, kind, seed=number), "disparity_range", "left")
            if fact.min_px is None:
                rows[kind].append((0.0, 0.0, np.nan))
                continue
            covered = fact.min_px <= low + 0.5, fact.max_px > high - 0.5
            rows[kind].append((*map(float, covered), (fact.max_px - fact.min_px) / (high - low)))
    lines = ["| distortion | pairs | low end covered | high end covered | width over the true one, median | 95 % |"]
    lines.append("|---|---|---|---|---|---|")
    for kind, values in (*rows.items(), ("all", [value for row in rows.values() for value in row])):
        known = np.array(values)
        widths = known[np.isfinite(known[:, 2]), 2]
        cover = 100 * known[:, :2].mean(axis=0)
        lines.append(
            f"| {kind} | {len(known)} | {cover[0]:.1f} % | {cover[1]:.1f} % | {np.median(widths):.2f} "
            f"| {np.percentile(widths, 95):.2f} |"
        )
    return "\n".join(lines)


def _true_range(truth_px: FloatImage, scored: Mask) -> tuple[float, float]:
    low, high = np.percentile(truth_px[scored], (0.5, 99.5))
    return float(low), float(high)


def times(repeats: int = 5) -> str:
    """Return the CPU time per probe on a rendered pair, one thread, ms; probes share what was measured before."""
    cv2.setNumThreads(1)
    made = render_terrain(TerrainParams(seed=5, width_px=1280, height_px=960, focal_px=1000.0))
    lines = [f"{'probe':32s} {'tier':8s}" + "".join(f"{width}x{height:<8d}" for width, height in SIZES)]
    found: dict[str, list[float]] = defaultdict(list)
    for size in SIZES:
        images = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (made.left, made.right)]
        views = Views(*(np.asarray(apply_sensor(_colour(image), SensorParams(noise_sigma_dn=1.0))) for image in images))
        best: dict[str, float] = defaultdict(lambda: np.inf)
        for _ in range(repeats):
            sample = Sample(views)
            for name, probe in probes().items():
                if probe.subject == "pair":
                    start = time.process_time()
                    probe.function(sample)
                    best[name] = min(best[name], 1e3 * (time.process_time() - start))
        for name, spent in best.items():
            found[name].append(spent)
    catalog = probes()
    lines += [f"{name:32s} {catalog[name].tier:8s}" + "".join(f"{t:8.1f}    " for t in v) for name, v in found.items()]
    for tier in ("cheap", "medium", "dear"):
        total = np.sum([v for name, v in found.items() if catalog[name].tier == tier], axis=0)
        if np.ndim(total):
            lines.append(f"{'all':32s} {tier:8s}" + "".join(f"{value:8.1f}    " for value in total))
    return "\n".join(lines)


def _colour(image: np.ndarray) -> np.ndarray:
    return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)


def page(folder: Path, every: int, seeds: int) -> str:
    """Return the page of the documentation."""
    return (
        "# How well facts tell what was simulated\n\n"
        "Written by `make bench-facts ARGS=--write`; not edited by hand. The error is what the fact says less what\n"
        "was simulated in one image; `2 sigma` is the share of errors within twice the stated uncertainty. Real\n"
        "pairs differ a little by themselves, which is part of the error.\n\n"
        f"{accuracy(folder, every, seeds)}\n\n"
        "## Sky\n\n"
        "Rendered terrain seen from a body that looks 12 degrees up to 6 degrees down.\n\n"
        f"{sky_quality(3)}\n\n"
        "## Disparity range\n\n"
        "The true range is that between the 0.5th and the 99.5th percentile of the true disparities; all development\n"
        f"pairs under each reference distortion.\n\n{range_quality(folder, every)}\n"
    )


def main(given: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--every", type=int, default=1, help="take every N-th pair only")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--write", action="store_true", help=f"write docs/{PAGE.name}")
    parser.add_argument("--time", action="store_true", help="measure the CPU time per probe instead")
    args = parser.parse_args(given)
    if args.time:
        print(times())
        return
    if not args.data:
        print(accuracy(None, args.every, args.seeds))
        return
    text = page(Path(args.data), args.every, args.seeds)
    if args.write:
        PAGE.write_text(text, encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
