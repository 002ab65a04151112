"""Noise of both images."""

from __future__ import annotations

from typing import ClassVar

from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.probe import FactModel, Probe, quantity


class Noise(FactModel):
    """Standard deviation of the noise, from the smoothest blocks."""

    template: ClassVar[str] = "noise"

    left_sigma_dn: float = quantity("Noise of the left image", unit="dn", ge=0, resolution=0.01)
    right_sigma_dn: float = quantity("Noise of the right image", unit="dn", ge=0, resolution=0.01)
    difference_dn: float = quantity("Right minus left noise", unit="dn", resolution=0.01)


def measure_noise(sample: Sample) -> list[Noise]:
    """Return the one `noise` fact of the pair; the green channel of colour images."""
    sigmas = [blocks.noise_dn for blocks in sample.noise_blocks]
    return [Noise(left_sigma_dn=sigmas[0], right_sigma_dn=sigmas[1], difference_dn=sigmas[1] - sigmas[0])]


PROBE = Probe(
    "measurement.noise",
    (Noise,),
    measure_noise,
    "cheap",
    "pair",
    "Estimates the noise from the smoothest blocks.",
    cost=Cost(fixed_ms=0.4, ns_per_pixel=1.6),
)
