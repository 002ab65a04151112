"""Simulate differences of known size and compare what the facts say: bias and spread per fact.

    TERREX_DATA=... python -m benchmarks.facts [--every N] [--seeds 2] [--write]   accuracy; --write renews the page
    python -m benchmarks.facts --time                                             CPU time per probe at two sizes

The differences are simulated in the right image of development pairs whose cameras agree and of rendered terrain. The
error of a fact is what it says less what was simulated; what the real cameras differ by themselves is part of it. The
column `2 sigma` gives the share of errors within twice the uncertainty that the fact itself states.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from benchmarks.causes import Damage, dead_columns, gradient, motion, pairs_of, sensor, stuck_pixels
from modules.catalog import probes
from modules.formats.datasets import read_index
from modules.measurement.sample import Sample
from modules.probe import FactModel
from modules.simulation.distortions import REFERENCE_DISTORTIONS, distort_right
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.simulation.terrain import TerrainParams, render_terrain
from modules.types import FloatImage, Image, Mask, Views, full_scale

PAGE = Path(__file__).parents[1] / "docs" / "facts_validation.md"
SIZES = ((640, 480), (1280, 960))


@dataclass(frozen=True)
class Check:
    """One difference of known size, and the field that shall tell it.

    Attributes
    ----------
    probe, field : str
        The fact; `field_sigma` is its uncertainty, where there is one.
    what : str
        The difference, for the table.
    damage : Damage
        Of the right image.
    truth : float or callable
        What the field should say, or how it follows from the image, the seed and the undamaged image.
    sigma : str, optional
        Field of the uncertainty.
    """

    probe: str
    field: str
    what: str
    damage: Damage
    truth: float | Callable[[Image, int], float]
    sigma: str | None = None


def radial_truth(loss: float) -> Callable[[Image, int], float]:
    """Return the slope of the log light over the squared radius: what a straight line makes of vignetting."""

    def truth(image: Image, seed: int) -> float:
        rows, columns = image.shape[:2]
        y, x = np.mgrid[:rows:4, :columns:4]
        r2 = ((x - columns / 2) ** 2 + (y - rows / 2) ** 2) / ((columns**2 + rows**2) / 4)
        return float(np.polyfit(r2.ravel(), np.log(1 - loss * r2).ravel(), 1)[0])

    return truth


def gradient_truth(image: Image, seed: int) -> float:
    """Return the magnitude of the gradient that `gradient` makes, over half the diagonal."""
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi)
    rows, columns = image.shape[:2]
    half = np.hypot(rows, columns) / 2
    return float(0.3 * half * np.hypot(np.cos(angle) / (columns / 2), np.sin(angle) / (rows / 2)))


def clipped_truth(image: Image, seed: int) -> float:
    """Return how many pixels a gain of 1.6 brings to full scale."""
    bright = image if image.ndim == 2 else image.max(axis=2)
    scale = full_scale(image) / 255
    return float(np.mean(np.rint(1.6 * bright / scale) >= 254) - np.mean(bright / scale >= 254))


def motion_truth(image: Image, seed: int) -> float:
    """Return the direction that `motion` draws, between -90 and 90 degrees."""
    angle = float(np.rad2deg(np.random.default_rng(seed).uniform(0, np.pi)))
    return (angle + 90) % 180 - 90


TURNED = sensor(shift_y_px=1.3, misalign_rad=0.003)
CHECKS: tuple[Check, ...] = (
    Check("radiometry", "gain", "gain 0.7", sensor(gain=0.7), 0.7, "gain_sigma"),
    Check("radiometry", "gain", "gain 0.7, vignetting 0.4", sensor(gain=0.7, vignetting=0.4), 0.7, "gain_sigma"),
    Check("radiometry", "gain", "gain 0.7, noise 6 dn", sensor(gain=0.7, noise_sigma_dn=6.0), 0.7, "gain_sigma"),
    Check("radiometry", "offset_dn", "offset 20 dn", sensor(offset_dn=20.0), 20.0, "offset_sigma_dn"),
    Check("radiometry", "difference_dn", "offset 20 dn", sensor(offset_dn=20.0), 20.0, "difference_sigma_dn"),
    Check("radiometry", "gamma", "exponent 1.4", sensor(gamma=(1.4, 1.4, 1.4)), 1.4, "gamma_sigma"),
    Check("radiometry", "gamma", "exponent 0.7", sensor(gamma=(0.7, 0.7, 0.7)), 0.7, "gamma_sigma"),
    Check(
        "radiometry", "cast_fraction", "channels x 1.1, 1, 0.9", sensor(cast=(1.1, 1.0, 0.9)), float(np.log(1.1 / 0.9)),
        "cast_sigma",
    ),
    Check("light_shape", "radial", "vignetting 0.4", sensor(vignetting=0.4), radial_truth(0.4), "radial_sigma"),
    Check("light_shape", "radial", "none", sensor(), 0.0, "radial_sigma"),
    Check("light_shape", "gradient", "light x 0.74 to 1.35", gradient, gradient_truth),
    Check("light_shape", "patchy", "none", sensor(), 0.0),
    Check("noise", "right_sigma_dn", "noise 4 dn", sensor(noise_sigma_dn=4.0), 4.0),
    Check("noise", "right_sigma_dn", "noise 10 dn", sensor(noise_sigma_dn=10.0), 10.0),
    Check("sharpness", "ratio", "none", sensor(), 1.0),
    Check("sharpness", "ratio", "gain 0.6, offset 20 dn", sensor(gain=0.6, offset_dn=20.0), 1.0),
    Check("saturation", "difference_fraction", "gain 1.6", sensor(gain=1.6), clipped_truth),
    Check("row_alignment", "offset_px", "1.3 px, 0.003 rad", TURNED, 1.3, "sigma_px"),
    Check("row_alignment", "roll_deg", "1.3 px, 0.003 rad", TURNED, 0.1719),
    Check("row_alignment", "offset_px", "12 px", sensor(shift_y_px=12.0), 12.0, "sigma_px"),
    Check("motion", "direction_deg", "9 px along a direction", motion, motion_truth),
    Check("defects", "stuck_difference_ppm", "500 stuck pixels in a million", stuck_pixels, 500.0),
    Check("defects", "lines_difference", "4 bright columns", dead_columns, 4.0),
)  # fmt: skip


@dataclass
class Errors:
    """Errors of one check, and how many lay within twice the stated uncertainty."""

    values: list[float]
    within: list[bool]
    missing: int = 0


def measure(views: Views, probe: str) -> FactModel:
    """Return the one fact of a probe."""
    return cast(FactModel, probes()[f"measurement.{probe}"].function(Sample(views))[0])


def add(errors: Errors, check: Check, views: Views, seed: int) -> None:
    """Measure one damaged pair."""
    right = check.damage(views.right, 1.0, seed)
    fact = measure(views.with_images(views.left, right), check.probe)
    value = getattr(fact, check.field)
    if value is None:
        errors.missing += 1
        return
    truth = check.truth if isinstance(check.truth, float) else check.truth(views.right, seed)
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


def range_quality(folder: Path, every: int) -> str:
    """Return how often the estimated disparity range covers the true one, and how much wider it is."""
    rows: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    for number, pair in enumerate(read_index(folder, "dev")):
        if number % every or pair.truth_px is None or pair.scored is None:
            continue
        low, high = _true_range(pair.truth_px, pair.scored)
        for kind in REFERENCE_DISTORTIONS:
            fact: Any = measure(distort_right(pair.views, kind, seed=number), "disparity_range")
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
        "was simulated in the right image; `2 sigma` is the share of errors within twice the stated uncertainty. Real\n"
        "pairs differ a little by themselves, which is part of the error.\n\n"
        f"{accuracy(folder, every, seeds)}\n\n"
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
