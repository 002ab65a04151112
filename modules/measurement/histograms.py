"""Histograms of both images."""

from __future__ import annotations

from typing import ClassVar, Literal, get_args

import numpy as np

from modules.measurement.sample import Sample
from modules.primitives.statistics import Floats, count_levels, entropy_bits, quantiles
from modules.probe import FactModel, Probe, quantity
from modules.types import Side

Channel = Literal["gray", "red", "green", "blue"]


class Histogram(FactModel):
    """Moments and quantiles of one channel of one image."""

    template: ClassVar[str] = "histogram"
    keys: ClassVar[tuple[str, ...]] = ("side", "channel")

    side: Side = quantity("Image of the pair")
    channel: Channel = quantity("Luminance or colour channel")
    mean_dn: float = quantity("Mean", unit="dn", ge=0, le=255, resolution=0.01)
    std_dn: float = quantity("Standard deviation", unit="dn", ge=0, le=128, resolution=0.01)
    p1_dn: float = quantity("1st percentile", unit="dn", ge=0, le=255, resolution=0.01)
    p50_dn: float = quantity("Median", unit="dn", ge=0, le=255, resolution=0.01)
    p99_dn: float = quantity("99th percentile", unit="dn", ge=0, le=255, resolution=0.01)
    entropy_bits: float = quantity("Entropy of the 256 levels", unit="bit", ge=0, le=8, resolution=0.001)
    occupied_range_dn: float = quantity("99th minus 1st percentile", unit="dn", ge=0, le=255, resolution=0.01)


def measure_histograms(sample: Sample) -> list[Histogram]:
    """Return one `histogram` fact per side and channel, from every second row and column."""
    sides: tuple[Side, ...] = get_args(Side)
    channels: tuple[Channel, ...] = get_args(Channel)
    return [
        _describe(side, channel, count_levels(sample.planes[channel][index]))
        for index, side in enumerate(sides)
        for channel in channels
        if channel in sample.planes
    ]


def _describe(side: Side, channel: Channel, counts: Floats) -> Histogram:
    levels = np.arange(len(counts))
    mean = float(counts @ levels / counts.sum())
    p1, p50, p99 = (float(value) for value in quantiles(counts, np.array([0.01, 0.5, 0.99])))
    return Histogram(
        side=side,
        channel=channel,
        mean_dn=mean,
        std_dn=float(np.sqrt(counts @ (levels - mean) ** 2 / counts.sum())),
        p1_dn=p1,
        p50_dn=p50,
        p99_dn=p99,
        entropy_bits=min(entropy_bits(counts), 8.0),
        occupied_range_dn=p99 - p1,
    )


PROBE = Probe(
    "measurement.histograms",
    (Histogram,),
    measure_histograms,
    "cheap",
    "pair",
    "Describes the histograms of both images.",
)
