"""Whether one image is smeared along a direction."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from scipy.linalg import eigh

from modules.measurement.sample import Gray, Indices, Sample
from modules.operator import Cost
from modules.primitives.statistics import Floats
from modules.primitives.stuck import CLIPPED_DN
from modules.probe import FactModel, Probe, quantity

STRONG_DN = 60.0  # gradients beyond this weigh less, so that a few edges do not decide
LEAST_ENERGY = 0.5  # dn^2; less gradient energy says nothing
ENOUGH_PX = 160_000  # pixels of the middle rows that suffice
CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
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
    tensors = [
        _tensor(gray, noise_dn, lines)
        for gray, noise_dn, lines in zip(sample.gray8, sample.middle_noise_dn, sample.lines, strict=True)
    ]
    if min(float(np.linalg.eigvalsh(tensor)[0]) for tensor in tensors) < LEAST_ENERGY:
        return [Motion()]
    values, vectors = eigh(tensors[1], tensors[0])
    # The smear lies where the blurred image lost energy: along the least ratio if that is the right one.
    smeared = vectors[:, 0] if values[0] * values[1] < 1 else vectors[:, 1]
    angle = float(np.rad2deg(np.arctan2(smeared[1], smeared[0])))
    return [Motion(anisotropy=float(np.clip(values[0] / values[1], 0, 1)), direction_deg=(angle + 90) % 180 - 90)]


def _tensor(gray: Gray, noise_dn: float, lines: tuple[Indices, Indices]) -> Floats:
    """Return the mean products of the gradients of the middle rows, without noise, clipped pixels and stuck lines."""
    rows = min(gray.shape[0], max(64, ENOUGH_PX // gray.shape[1]))
    first = (gray.shape[0] - rows) // 2
    values = gray[first : first + rows]
    if min(values.shape) < 3:
        return np.zeros((2, 2))
    across = np.subtract(values[1:-1, 2:], values[1:-1, :-2], dtype=np.float32)
    down = np.subtract(values[2:, 1:-1], values[:-2, 1:-1], dtype=np.float32)
    weight = across * across
    weight += down * down
    weight *= np.float32(1 / STRONG_DN**2)
    weight += np.float32(1)
    np.reciprocal(weight, out=weight)
    weight[cv2.dilate(values, CROSS)[1:-1, 1:-1] >= CLIPPED_DN] = 0
    for index, axis in ((lines[0] - first, 0), (lines[1], 1)):
        beside = np.unique(np.concatenate([index - 2, index - 1, index]))  # of the inner pixels, which begin at 1
        np.moveaxis(weight, axis, 0)[beside[(beside >= 0) & (beside < weight.shape[axis])]] = 0
    weighted_across, weighted_down = across * weight, down * weight
    mixed = float(np.vdot(weighted_across, down))
    energy = np.array([[float(np.vdot(weighted_across, across)), mixed], [mixed, float(np.vdot(weighted_down, down))]])
    used = np.count_nonzero(weight)
    return energy / max(used, 1) - NOISE_SHARE * noise_dn**2 * np.eye(2)


PROBE = Probe(
    "measurement.motion",
    (Motion,),
    measure_motion,
    "medium",
    "pair",
    "Compares the fine gradients by direction.",
    cost=Cost(fixed_ms=2, ns_per_pixel=2),
)
