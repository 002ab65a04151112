"""Histograms of both images."""

from __future__ import annotations

from typing import ClassVar, Literal, get_args

import numpy as np

from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.primitives.statistics import Floats, entropy_bits, quantiles
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
    p5_dn: float = quantity("5th percentile", unit="dn", ge=0, le=255, resolution=0.01)
    p50_dn: float = quantity("Median", unit="dn", ge=0, le=255, resolution=0.01)
    p95_dn: float = quantity("95th percentile", unit="dn", ge=0, le=255, resolution=0.01)
    p99_dn: float = quantity("99th percentile", unit="dn", ge=0, le=255, resolution=0.01)
    entropy_bits: float = quantity("Entropy of the 256 levels", unit="bit", ge=0, le=8, resolution=0.001)
    skewness: float = quantity("Third standardized moment; positive: a tail of bright pixels", resolution=0.001)
    bimodality: float = quantity(
        "Sarle's coefficient: 1 for two levels, 0.556 for a flat histogram, 0.333 for a Gaussian",
        ge=0,
        le=1,
        resolution=0.001,
    )
    occupied_range_dn: float = quantity("99th minus 1st percentile", unit="dn", ge=0, le=255, resolution=0.01)


def measure_histograms(sample: Sample) -> list[Histogram]:
    """Return one `histogram` fact per side and channel, from every few rows."""
    sides: tuple[Side, ...] = get_args(Side)
    channels: tuple[Channel, ...] = get_args(Channel)
    return [
        _describe(side, channel, sample.counts[channel][index])
        for index, side in enumerate(sides)
        for channel in channels
        if channel in sample.counts
    ]


def _describe(side: Side, channel: Channel, counts: Floats) -> Histogram:
    levels = np.arange(len(counts))
    mean = float(counts @ levels / counts.sum())
    p1, p5, p50, p95, p99 = (float(value) for value in quantiles(counts, np.array([0.01, 0.05, 0.5, 0.95, 0.99])))
    from_mean = levels - mean
    squares = from_mean * from_mean
    variance, third, fourth = (
        float(counts @ powers / counts.sum()) for powers in (squares, squares * from_mean, squares * squares)
    )
    spread = max(variance, 1e-9)
    skewness = third / spread**1.5
    return Histogram(
        side=side,
        channel=channel,
        mean_dn=mean,
        std_dn=float(np.sqrt(variance)),
        p1_dn=p1,
        p5_dn=p5,
        p50_dn=p50,
        p95_dn=p95,
        p99_dn=p99,
        entropy_bits=min(entropy_bits(counts), 8.0),
        skewness=skewness,
        bimodality=min(1.0, (skewness**2 + 1) * spread**2 / max(fourth, spread**2)),
        occupied_range_dn=p99 - p1,
    )


PROBE = Probe(
    "measurement.histograms",
    (Histogram,),
    measure_histograms,
    "cheap",
    "pair",
    "Describes the histograms of both images.",
    cost=Cost(fixed_ms=0.7, ns_per_pixel=1.1),
)
