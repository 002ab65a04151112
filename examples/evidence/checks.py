"""Print what is matched where nothing should be: unrelated images, noise and gratings, by profile.

The evidence behind MAT040 and the slot `confidence`: share of pixels that get a disparity, %, and the repetition that
the texture probe reads; below it the repetition of all pairs of a data set, for comparison.

    [TERREX_DATA=FOLDER] python examples/evidence/checks.py
"""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from expert import ExpertSystem, StereoPair
from modules.formats.datasets import read_index
from modules.measurement.sample import Sample
from modules.measurement.texture import measure_texture
from modules.types import Views

SIZE = (240, 640)  # the first columns see only one period of a grating within the range, and are right
PROFILES = ("fast", "balanced", "best")


def noise(seed: int, sigma_px: float) -> NDArray[np.uint8]:
    """Return noise of a given smoothness, mean 128 and deviation 40."""
    values = np.random.default_rng(seed).normal(0.0, 1.0, SIZE)
    if sigma_px:
        values = cv2.GaussianBlur(values, (0, 0), sigma_px)
    return np.clip(128 + 40 * values / values.std(), 0, 255).astype(np.uint8)


def grating(period_px: float, shift_px: int, seed: int) -> NDArray[np.uint8]:
    """Return a sine along the rows with noise of 3 DN."""
    wave = 128 + 60 * np.sin(2 * np.pi * (np.arange(SIZE[1]) + shift_px) / period_px)
    return np.clip(wave + np.random.default_rng(seed).normal(0, 3, SIZE), 0, 255).astype(np.uint8)


def hopeless() -> dict[str, tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Return pairs without any true correspondence, or with many equally good ones."""
    pairs = {f"noise, smooth by {s} px": (noise(1, s), noise(2, s)) for s in (0.0, 0.7, 1.5, 3.0, 6.0)}
    pairs |= {f"grating of {p} px": (grating(p, 0, 3), grating(p, 5, 4)) for p in (6.0, 11.0, 24.0)}
    pairs["flat with noise of 1 DN"] = tuple(
        np.rint(np.random.default_rng(seed).normal(90, 1, SIZE)).astype(np.uint8) for seed in (5, 6)
    )  # type: ignore[assignment]
    return pairs


def main() -> None:
    systems = {profile: ExpertSystem(profile=profile) for profile in PROFILES}
    print(f"{'pair':28s} {'repetition':>10s}" + "".join(f"{profile:>10s}" for profile in PROFILES))
    for name, (left, right) in hopeless().items():
        repetition = measure_texture(Sample(Views(left, right)))[0].row_repetition
        shares = [
            100
            * np.isfinite(system.reconstruct(StereoPair(left, right, disparity_range_px=(0, 64))).disparity_px).mean()
            for system in systems.values()
        ]
        print(f"{name:28s} {repetition:10.2f}" + "".join(f"{share:10.1f}" for share in shares))
    data = os.environ.get("TERREX_DATA")
    if data:
        read = [measure_texture(Sample(pair.views))[0].row_repetition for pair in read_index(Path(data))]
        print(
            f"repetition of the {len(read)} pairs of the data set: median {np.median(read):.2f}, most {max(read):.2f}"
        )


if __name__ == "__main__":
    main()
