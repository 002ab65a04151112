"""How much texture the left image offers to a matcher."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.primitives.statistics import median
from modules.probe import FactModel, Probe, quantity

WEAK_GRADIENT_DN = 1.5  # mean |dg/dx| at half size below which a matcher has little to go by


class Texture(FactModel):
    """Texture along the rows of the left image, at half size."""

    template: ClassVar[str] = "texture"

    textureless_fraction: float = quantity(
        "Pixels whose 9x9 mean of the horizontal gradient at half size is below 1.5 dn/px", ge=0, le=1, resolution=0.001
    )
    gradient_energy_dn: float = quantity("Mean horizontal gradient at half size", unit="dn/px", ge=0, resolution=0.01)
    row_repetition: float = quantity(
        "Median over rows of the highest second peak of the autocorrelation; near 1 on periodic patterns",
        ge=0,
        le=1,
        resolution=0.001,
    )


def measure_texture(sample: Sample) -> list[Texture]:
    """Return the one `texture` fact of the pair."""
    gray = sample.half[0]
    gradient = np.abs(cv2.Sobel(gray, cv2.CV_16S, 1, 0, ksize=3)).astype(np.float32) / 8
    local = cv2.blur(gradient, (9, 9))
    return [
        Texture(
            textureless_fraction=float(np.mean(local < WEAK_GRADIENT_DN)),
            gradient_energy_dn=float(gradient.mean()),
            row_repetition=_repetition(gray),
        )
    ]


def _repetition(gray: NDArray[np.uint8]) -> float:
    rows = gray[:: max(1, gray.shape[0] // 40)].astype(np.float32)
    count = rows.shape[1]
    if count < 32:
        return 0.0
    rows = rows - cv2.blur(rows, (31, 1))
    length = cv2.getOptimalDFTSize(count + count // 2)  # padded so that no row meets itself within half of it
    spectrum = np.fft.rfft(rows, length, axis=1)
    power = spectrum.real**2 + spectrum.imag**2
    correlation = np.fft.irfft(power, length, axis=1)[:, : count // 2]
    usable = correlation[:, 0] > count * WEAK_GRADIENT_DN**2
    if np.count_nonzero(usable) < 3:
        return 0.0
    overlap = 1 - np.arange(count // 2) / count
    relative = correlation[usable] / correlation[usable, :1] / overlap
    # Peaks count only beyond the first time the correlation falls below zero: the main lobe is not a repetition.
    beyond = np.logical_or.accumulate(relative < 0, axis=1)
    peaks = np.where(beyond, relative, 0).max(axis=1)
    return float(np.clip(median(peaks), 0, 1))


PROBE = Probe(
    "measurement.texture",
    (Texture,),
    measure_texture,
    "cheap",
    "pair",
    "Measures texture and repetition along rows.",
    cost=Cost(fixed_ms=0.3, ns_per_pixel=1.1),
)
