"""Simulate causes of a difference on development pairs and see which findings name them: a confusion matrix.

    TERREX_DATA=... python -m benchmarks.causes [--every N] [--seeds 2] [--first-seed 0] [--rendered 0] [--doubles 0|1]
                                                [--only CAUSE ...] [--group] [--profile balanced]

Every cause is simulated on the pairs whose cameras agree and on rendered terrain, at three strengths, in the right
image for even seeds and in the left one for odd seeds. A single cause counts as named if its finding is derived; the
matrix shows what else is. Two causes at once count as named if both are. A clean pair counts as left alone if no
correction is planned. The thresholds of the rules are the same for all pairs and were set on the development pairs with
seeds 0 and 1, so that other seeds and rendered terrain are the more honest test; below the matrix stands what is named
in each group of scenes, which is what a group left out would have given.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from expert import ExpertSystem, StereoPair
from modules.formats.datasets import DatasetPair, read_index
from modules.simulation.distortions import scale_distortion
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.simulation.terrain import TerrainParams, render_terrain
from modules.types import Image, Views, full_scale

STRENGTHS = (0.75, 1.0, 1.5)
ONE_CAUSE, TWO_CAUSES = "one cause", "two causes"  # rows that sum up
Damage = Callable[[Image, float, int], Image]  # image, strength, seed


@dataclass(frozen=True)
class Cause:
    """What damages one image, the finding that shall name it, and findings that are as true."""

    damage: Damage
    finding: str
    as_true: frozenset[str] = frozenset()
    kind: str = "tone"  # two causes of one kind are not combined


def sensor(**values: object) -> Damage:
    """Return a damage by `apply_sensor`."""
    params = SensorParams(**values)
    return lambda image, strength, seed: apply_sensor(image, scale_distortion(params, strength), seed=seed)


def gradient(image: Image, strength: float, seed: int) -> Image:
    """Light grows by a factor of 1.35 from the middle to one side, in a direction drawn by the seed."""
    rows, columns = image.shape[:2]
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi)
    y, x = np.mgrid[:rows, :columns]
    along = np.cos(angle) * (2 * x / columns - 1) + np.sin(angle) * (2 * y / rows - 1)
    light = np.exp(0.3 * strength * along)
    return _stored(image, image * (light if image.ndim == 2 else light[..., None]))


def motion(image: Image, strength: float, seed: int) -> Image:
    """Move over 9 px while the shutter is open, in a direction drawn by the seed."""
    angle = np.random.default_rng(seed).uniform(0, np.pi)
    length, half = 9 * strength, 10
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for step in np.linspace(-length / 2, length / 2, 65):
        column, row = half + step * np.cos(angle), half + step * np.sin(angle)
        c, r = int(column), int(row)
        for i, j in itertools.product((0, 1), (0, 1)):
            kernel[r + i, c + j] += (1 - abs(row - r - i)) * (1 - abs(column - c - j))
    return _stored(image, cv2.filter2D(image.astype(np.float32), -1, kernel / kernel.sum()))


def compression(image: Image, strength: float, seed: int) -> Image:
    """Compress by JPEG at quality 20; stronger is worse."""
    eight = image if image.dtype == np.uint8 else (image / 257).astype(np.uint8)
    bgr = np.ascontiguousarray(eight[..., ::-1]) if eight.ndim == 3 else eight
    _, code = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, round(20 / strength)])
    back = np.asarray(cv2.imdecode(code, cv2.IMREAD_UNCHANGED))
    back = back[..., ::-1] if back.ndim == 3 else back
    return _stored(image, back.astype(float) * (full_scale(image) / 255))


def stuck_pixels(image: Image, strength: float, seed: int) -> Image:
    """Set 500 pixels in a million to full or no signal."""
    random = np.random.default_rng(seed)
    damaged = image.copy()
    rows, columns = image.shape[:2]
    count = round(500e-6 * strength * rows * columns)
    y, x = random.integers(rows, size=count), random.integers(columns, size=count)
    level = random.choice([0, full_scale(image)], size=count)
    damaged[y, x] = level if image.ndim == 2 else level[:, None]
    return damaged


def dead_columns(image: Image, strength: float, seed: int) -> Image:
    """Let some columns read 40 dn too much."""
    random = np.random.default_rng(seed)
    damaged = image.astype(float)
    x = random.choice(image.shape[1], size=round(4 * strength), replace=False)
    damaged[:, x] += 40 * full_scale(image) / 255
    return _stored(image, damaged)


def _stored(image: Image, values: np.ndarray) -> Image:
    return cast(Image, np.clip(np.rint(values), 0, full_scale(image)).astype(image.dtype))


CLIPPED = frozenset({"clipped-differently"})  # true of many: what was clipped is not any more, or the reverse
EXPOSED = CLIPPED | {"exposure-differs"}
UNEVEN = CLIPPED | {"light-uneven"}
CAUSES: Mapping[str, Cause] = {
    "gain": Cause(sensor(gain=0.7), "exposure-differs", CLIPPED),
    "bright": Cause(sensor(gain=1.3), "exposure-differs", CLIPPED),
    "offset": Cause(sensor(offset_dn=20.0), "exposure-differs", CLIPPED),
    "gamma": Cause(sensor(gamma=(1.4, 1.4, 1.4)), "response-differs", EXPOSED),
    "flat gamma": Cause(sensor(gamma=(0.7, 0.7, 0.7)), "response-differs", EXPOSED),
    "cast": Cause(sensor(cast=(1.1, 1.0, 0.9)), "colour-cast-differs", EXPOSED),
    "vignetting": Cause(sensor(vignetting=0.4), "vignetted", UNEVEN, "place"),
    "gradient": Cause(gradient, "lighting-gradient", UNEVEN, "place"),
    "local light": Cause(sensor(spot_gain=1.6, shadow_gain=0.55), "light-patchy", UNEVEN, "place"),
    "noise": Cause(sensor(noise_sigma_dn=8.0), "noisy", CLIPPED | {"noisy-heavily"}, "grain"),
    "blur": Cause(sensor(blur_sigma_px=1.3), "sharpness-differs", frozenset(), "grain"),
    "motion": Cause(motion, "motion-blurred", frozenset({"sharpness-differs"}), "grain"),
    "rows": Cause(sensor(misalign_rad=0.003, shift_y_px=1.3), "rows-misaligned", frozenset(), "rows"),
    "clipping": Cause(sensor(gain=1.8, offset_dn=10.0), "clipped-differently", EXPOSED),
    "stuck pixels": Cause(stuck_pixels, "sensor-defective", frozenset(), "sensor"),
    "bad columns": Cause(dead_columns, "sensor-defective", frozenset(), "sensor"),
    "compression": Cause(compression, "compression-blocks", frozenset({"sharpness-differs"}), "grain"),
}
NAMED = (
    "exposure-differs", "response-differs", "colour-cast-differs", "vignetted", "lighting-gradient", "light-patchy",
    "light-uneven", "clipped-differently", "noisy", "noisy-heavily", "sharpness-differs", "motion-blurred",
    "compression-blocks", "sensor-defective", "rows-misaligned", "images-swapped",
)  # fmt: skip


def damaged(views: Views, damages: list[Damage], strength: float, seed: int) -> Views:
    """Return the views with one image damaged: the right one for even seeds, the left one for odd ones."""
    image = views.left if seed % 2 else views.right
    for number, damage in enumerate(damages):
        image = damage(image, strength, seed + 1000 * number)
    return views.with_images(image, views.right) if seed % 2 else views.with_images(views.left, image)


def applies(name: str, views: Views) -> bool:
    """Say whether a cause can show: a cast needs colour, clipping needs something bright."""
    if name == "cast":
        return views.left.ndim == 3
    if name == "clipping":
        bright = views.right if views.right.ndim == 2 else views.right.max(axis=2)
        return bool(np.mean(bright > 0.6 * full_scale(views.right)) > 0.15)
    return True


@dataclass
class Subject:
    """A pair whose cameras agree, the group of scenes it belongs to, and the first of its own seeds."""

    views: Views
    group: str
    first_seed: int


@dataclass
class Tally:
    """Findings of one row of the matrix."""

    count: int = 0
    named: int = 0
    exact: int = 0
    findings: dict[str, int] | None = None
    by_group: dict[str, list[bool]] | None = None

    def add(self, found: set[str], wanted: set[str], as_true: set[str], group: str) -> None:
        """Count one pair."""
        self.count += 1
        self.named += wanted <= found
        self.exact += wanted <= found <= wanted | as_true
        self.findings = self.findings or defaultdict(int)
        self.by_group = self.by_group or defaultdict(list)
        for name in found:
            self.findings[name] += 1
        self.by_group[group].append(wanted <= found)


def findings_of(system: ExpertSystem, views: Views) -> tuple[set[str], bool, float]:
    """Return the findings about the causes, whether a correction is planned, and the CPU time."""
    start = time.process_time()
    decision = system.decide(StereoPair(views.left, views.right))
    spent = time.process_time() - start
    found = {finding.name for finding in decision.findings} & set(NAMED)
    planned = any(step.operator != "none" for step in decision.plans["correction"].steps)
    return found, planned, spent


def pairs_of(folder: Path, every: int) -> Iterator[tuple[int, DatasetPair]]:
    """Yield the pairs whose cameras agree and whose rows correspond."""
    entries = json.loads((folder / "INDEX.json").read_text(encoding="utf-8"))
    crooked = {f"{item['dataset']}/{item['scene']}" for item in entries if item.get("imperfect_rectification")}
    agreeing = [pair for pair in read_index(folder, "dev") if not pair.differs and pair.name not in crooked]
    yield from ((number, pair) for number, pair in enumerate(agreeing) if number % every == 0)


def subjects(folder: Path, every: int, rendered: int, first_seed: int) -> Iterator[Subject]:
    """Yield development pairs, and rendered terrain seen from a slightly tilted body."""
    for number, pair in pairs_of(folder, every):
        yield Subject(pair.views, pair.group, 100 * number + first_seed)
    for number in range(rendered):
        made = render_terrain(TerrainParams(seed=900 + number, roll_deg=2.0, pitch_deg=-6.0))
        yield Subject(Views(made.left, made.right), f"rendered {number}", 100 * (500 + number) + first_seed)


def singles(system: ExpertSystem, subject: Subject, seeds: int, rows: dict[str, Tally], only: set[str]) -> None:
    """Count the single causes on one pair."""
    for name, cause in CAUSES.items():
        if (only and name not in only) or not applies(name, subject.views):
            continue
        for strength, seed in itertools.product(STRENGTHS, range(seeds)):
            views = damaged(subject.views, [cause.damage], strength, subject.first_seed + seed)
            found, _, _ = findings_of(system, views)
            for row in (name, f"{name} x{strength:g}", ONE_CAUSE):
                rows[row].add(found, {cause.finding}, set(cause.as_true), subject.group)


def doubles(system: ExpertSystem, subject: Subject, rows: dict[str, Tally], only: set[str]) -> None:
    """Count two causes at once, one damage for each combination of kinds."""
    for index, (a, b) in enumerate(itertools.combinations(CAUSES, 2)):
        if CAUSES[a].kind == CAUSES[b].kind or not (applies(a, subject.views) and applies(b, subject.views)):
            continue
        if only and not {a, b} <= only:
            continue
        first, second = CAUSES[a], CAUSES[b]
        # Light falls on the scene before the sensor answers, and noise, defects and compression come last.
        order = sorted(
            (first, second), key=lambda cause: ["rows", "place", "tone", "grain", "sensor"].index(cause.kind)
        )
        views = damaged(subject.views, [cause.damage for cause in order], 1.0, subject.first_seed + index)
        found, _, _ = findings_of(system, views)
        wanted, as_true = {first.finding, second.finding}, set(first.as_true | second.as_true)
        for row in (f"{a} + {b}", TWO_CAUSES):
            rows[row].add(found, wanted, as_true, subject.group)


def report_groups(rows: Mapping[str, Tally]) -> None:
    """Print the share named per group of scenes, the worst last."""
    told = {name: rows[name].by_group or {} for name in (ONE_CAUSE, TWO_CAUSES) if name in rows}
    for name, groups in told.items():
        shares = sorted(
            ((100 * float(np.mean(hits)), group, len(hits)) for group, hits in groups.items()), reverse=True
        )
        print(f"\n{name}, named per group: " + ", ".join(f"{group} {share:.0f} %" for share, group, _ in shares))
        print(f"worst: {shares[-1][1]}, {shares[-1][0]:.1f} % of {shares[-1][2]}")


def report(rows: Mapping[str, Tally], by_group: bool) -> None:
    """Print how many were named and the confusion matrix in %."""
    shown = [name for name in NAMED if any(name in (row.findings or {}) for row in rows.values())]
    print("\n" + " ".join(f"{number}={name}" for number, name in enumerate(shown, start=1)))
    print(
        f"{'cause':32s} {'count':>6s} {'named':>6s} {'exact':>6s} "
        + " ".join(f"{n:>4d}" for n in range(1, len(shown) + 1))
    )
    for name, row in rows.items():
        shares = [100 * (row.findings or {}).get(finding, 0) / row.count for finding in shown]
        cells = " ".join(f"{share:4.0f}" if share else "   ." for share in shares)
        print(
            f"{name:32s} {row.count:6d} {100 * row.named / row.count:6.1f} {100 * row.exact / row.count:6.1f} {cells}"
        )
        if by_group and row.by_group:
            missed = {group: 100 * np.mean(hits) for group, hits in row.by_group.items() if not all(hits)}
            if missed:
                print("    missed in " + ", ".join(f"{group} {share:.0f} %" for group, share in missed.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default=os.environ.get("TERREX_DATA"), help="folder with an INDEX.json")
    parser.add_argument("--every", type=int, default=1, help="take every N-th pair only")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=0, help="of the damages; the rules were set with 0")
    parser.add_argument("--rendered", type=int, default=0, help="rendered terrains beside the pairs")
    parser.add_argument("--only", nargs="*", default=[], help="causes to simulate; all by default")
    parser.add_argument("--doubles", type=int, default=1, choices=(0, 1), help="whether to simulate two causes too")
    parser.add_argument("--group", action="store_true", help="name the scene groups in which a cause was missed")
    parser.add_argument("--profile", default="balanced")
    args = parser.parse_args()
    if not args.data:
        raise SystemExit("no data: set TERREX_DATA or give --data FOLDER")
    system = ExpertSystem(profile=args.profile, engine="compiled")
    rows: dict[str, Tally] = defaultdict(Tally)
    spent: list[float] = []
    for subject in subjects(Path(args.data), args.every, args.rendered, args.first_seed):
        found, planned, seconds = findings_of(system, subject.views)
        spent.append(seconds)
        rows["clean, nothing found"].add(found, set(), set(), subject.group)
        rows["clean, no correction"].add({"correction planned"} if planned else set(), set(), set(), subject.group)
        found, _, _ = findings_of(system, Views(subject.views.right, subject.views.left))
        rows["swapped"].add(found, {"images-swapped"}, set(), subject.group)
        singles(system, subject, args.seeds, rows, set(args.only))
        if args.doubles:
            doubles(system, subject, rows, set(args.only))
    report(rows, args.group)
    report_groups(rows)
    print(f"\nCPU time of a decision on a clean pair: median {1e3 * np.median(spent):.0f} ms")


if __name__ == "__main__":
    main()
