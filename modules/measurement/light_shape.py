"""How the light difference between the images changes over the image."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.probe import FactModel, Probe, quantity


class LightShape(FactModel):
    """Log ratio of right over left brightness by place; absent fields: too few corresponding points."""

    template: ClassVar[str] = "light_shape"

    radial: float | None = quantity(
        "Log ratio in the corners against the centre; negative: the right image falls off more",
        resolution=0.001,
        sigma="radial_sigma",
        default=None,
    )
    radial_sigma: float | None = quantity("Standard error of the radial part", ge=0, resolution=0.001, default=None)
    across: float | None = quantity(
        "Log ratio gained over half the diagonal to the right", resolution=0.001, sigma="across_sigma", default=None
    )
    across_sigma: float | None = quantity("Standard error of `across`", ge=0, resolution=0.001, default=None)
    down: float | None = quantity(
        "Log ratio gained over half the diagonal downwards", resolution=0.001, sigma="down_sigma", default=None
    )
    down_sigma: float | None = quantity("Standard error of `down`", ge=0, resolution=0.001, default=None)
    gradient: float | None = quantity(
        "Magnitude of the gradient, `across` and `down`",
        ge=0,
        resolution=0.001,
        sigma="gradient_sigma",
        default=None,
    )
    gradient_sigma: float | None = quantity(
        "Standard error of the gradient, the larger of its parts", ge=0, resolution=0.001, default=None
    )
    gradient_deg: float | None = quantity(
        "Direction in which the right image becomes brighter, if it is certain; 0 is right, 90 is down",
        unit="deg",
        ge=-180,
        le=180,
        resolution=1.0,
        default=None,
    )
    patchy: float | None = quantity(
        "Standard deviation over patches of the log ratio that neither tone, vignetting nor a gradient explains",
        ge=0,
        resolution=0.001,
        default=None,
    )


def measure_light_shape(sample: Sample) -> list[LightShape]:
    """Return the one `light_shape` fact of the pair."""
    light = sample.light
    if light is None:
        return [LightShape()]
    gradient = float(np.hypot(light.across, light.down))
    gradient_sigma = max(light.across_sigma, light.down_sigma)
    return [
        LightShape(
            radial=light.radial,
            radial_sigma=light.radial_sigma,
            across=light.across,
            across_sigma=light.across_sigma,
            down=light.down,
            down_sigma=light.down_sigma,
            gradient=gradient,
            gradient_sigma=gradient_sigma,
            gradient_deg=(
                float(np.rad2deg(np.arctan2(light.down, light.across))) if gradient > 2 * gradient_sigma else None
            ),
            patchy=light.patchy,
        )
    ]


PROBE = Probe(
    "measurement.light_shape",
    (LightShape,),
    measure_light_shape,
    "medium",
    "pair",
    "Splits the light difference of corresponding points into vignetting, gradient and patches.",
    cost=Cost(fixed_ms=3, ns_per_pixel=2),
)
