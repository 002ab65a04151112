"""How the noise depends on the signal."""

from __future__ import annotations

from typing import ClassVar, get_args

from modules.measurement.sample import Sample
from modules.primitives.noise import fit_noise_line
from modules.probe import FactModel, Probe, quantity
from modules.types import Side


class NoiseModel(FactModel):
    """Variance of the noise as `floor + slope * level` of one image; absent fields: its levels span too little."""

    template: ClassVar[str] = "noise_model"
    keys: ClassVar[tuple[str, ...]] = ("side",)

    side: Side = quantity("Image of the pair")
    floor_dn2: float | None = quantity(
        "Variance at level 0, of the electronics", unit="dn^2", resolution=0.01, sigma="floor_sigma_dn2", default=None
    )
    floor_sigma_dn2: float | None = quantity(
        "Standard error of the floor", unit="dn^2", ge=0, resolution=0.01, default=None
    )
    slope_dn: float | None = quantity(
        "Variance gained per level, of the photons; the inverse of the electrons per level",
        unit="dn",
        resolution=0.0001,
        sigma="slope_sigma_dn",
        default=None,
    )
    slope_sigma_dn: float | None = quantity(
        "Standard error of the slope", unit="dn", ge=0, resolution=0.0001, default=None
    )


def measure_noise_model(sample: Sample) -> list[NoiseModel]:
    """Return one `noise_model` fact per image; the green channel of colour images."""
    found = []
    for side, blocks in zip(get_args(Side), sample.noise_blocks, strict=True):
        line = fit_noise_line(blocks)
        if line is None:
            found.append(NoiseModel(side=side))
            continue
        found.append(
            NoiseModel(
                side=side,
                floor_dn2=line.floor_dn2,
                floor_sigma_dn2=line.floor_sigma_dn2,
                slope_dn=line.slope_dn,
                slope_sigma_dn=line.slope_sigma_dn,
            )
        )
    return found


PROBE = Probe(
    "measurement.noise_model",
    (NoiseModel,),
    measure_noise_model,
    "medium",
    "pair",
    "Fits the variance of the noise against the level.",
)
