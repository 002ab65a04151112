"""Whether one image is smeared along a direction."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from scipy.linalg import eigh

from modules.measurement.sample import Gray, Sample
from modules.primitives.noise import estimate_noise_dn
from modules.primitives.statistics import Floats
from modules.probe import FactModel, Probe, quantity

STRONG_DN = 60.0  # gradients beyond this weigh less, so that a few edges do not decide
LEAST_ENERGY = 0.5  # dn^2; less gradient energy says nothing
ENOUGH_PX = 250_000  # pixels of the middle rows that suffice
NOISE_SHARE = 2.0  # noise variance in a difference of two pixels


class Motion(FactModel):
    """Difference of the fine gradients by direction; absent fields: too little texture."""

    template: ClassVar[str] = "motion"

    anisotropy: float | None = quantity(
        "Least over largest ratio of gradient energy between the images over all directions; 1: blurred alike, or not",
        ge=0,
        le=1,
        resolution=0.001,
        default=None,
    )
    direction_deg: float | None = quantity(
        "Direction of the smear, clockwise from the row", unit="deg", ge=-90, le=90, resolution=1.0, default=None
    )


def measure_motion(sample: Sample) -> list[Motion]:
    """Return the one `motion` fact of the pair.

    The structure tensor of one image relative to that of the other: its generalised eigenvalues do not depend on gain
    or on the texture of the scene, and blur lowers the one along its direction.
    """
    tensors = [_tensor(gray) for gray in sample.gray8]
    if min(float(np.linalg.eigvalsh(tensor)[0]) for tensor in tensors) < LEAST_ENERGY:
        return [Motion()]
    values, vectors = eigh(tensors[1], tensors[0])
    # The smear lies where the blurred image lost energy: along the least ratio if that is the right one.
    smeared = vectors[:, 0] if values[0] * values[1] < 1 else vectors[:, 1]
    angle = float(np.rad2deg(np.arctan2(smeared[1], smeared[0])))
    return [Motion(anisotropy=float(np.clip(values[0] / values[1], 0, 1)), direction_deg=(angle + 90) % 180 - 90)]


def _tensor(gray: Gray) -> Floats:
    rows = min(gray.shape[0], max(64, ENOUGH_PX // gray.shape[1]))
    first = (gray.shape[0] - rows) // 2
    values = gray[first : first + rows].astype(np.float32)
    if min(values.shape) < 3:
        return np.zeros((2, 2))
    across = values[1:-1, 2:] - values[1:-1, :-2]
    down = values[2:, 1:-1] - values[:-2, 1:-1]
    weight = 1 / (1 + (across * across + down * down) / STRONG_DN**2)
    noise = NOISE_SHARE * estimate_noise_dn(gray) ** 2
    mixed = float(np.mean(weight * across * down))
    return np.array(
        [
            [float(np.mean(weight * across * across)) - noise, mixed],
            [mixed, float(np.mean(weight * down * down)) - noise],
        ]
    )


PROBE = Probe(
    "measurement.motion", (Motion,), measure_motion, "medium", "pair", "Compares the fine gradients by direction."
)
