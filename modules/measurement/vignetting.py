"""How much each image by itself falls off towards its corners."""

from __future__ import annotations

from typing import ClassVar, get_args

import cv2
import numpy as np

from modules.measurement.sample import Gray, Sample
from modules.primitives.statistics import fit_linear
from modules.probe import FactModel, Probe, quantity
from modules.types import Side

WIDTH_PX = 64  # of the thumbnail; noise and fine texture vanish
USABLE_DN = (8.0, 247.0)
LOG_FLOOR_DN = 4.0  # added before logarithms; darker pixels say little about gain
LEAST_POINTS = 100
SCALE_FLOOR = 0.002  # smallest robust deviation of the gradients, log per px of the thumbnail
CORRELATED = 5.0  # standard errors of independent points are too small by this: neighbouring gradients are alike
MODEL_ERROR = 0.12  # lamps, sky and ground look like a little of it: see docs/facts_validation.md


class Vignetting(FactModel):
    """Fall-off of one image by itself; absent: too little of it is neither clipped nor black."""

    template: ClassVar[str] = "vignetting"
    keys: ClassVar[tuple[str, ...]] = ("side",)

    side: Side = quantity("Image of the pair")
    falloff: float | None = quantity(
        "Log brightness lost from the centre to the corners, as the square of the distance",
        resolution=0.001,
        sigma="falloff_sigma",
        default=None,
    )
    falloff_sigma: float | None = quantity("Standard error of the fall-off", ge=0, resolution=0.001, default=None)


def measure_vignetting(sample: Sample) -> list[Vignetting]:
    """Return one `vignetting` fact per image.

    The gradients of the log brightness of a scene point to all sides and are mostly near zero; vignetting adds a small
    one that points to the centre and grows with the distance from it. A robust fit tells it from the scene, and from
    light that changes steadily from one side to the other.

    References
    ----------
    Y. Zheng, J. Yu, S. B. Kang, S. Lin, C. Kambhamettu, Single-image vignetting correction using radial gradient
    symmetry, CVPR 2008.
    """
    return [_measure(side, gray) for side, gray in zip(get_args(Side), sample.quarter, strict=True)]


def _measure(side: Side, gray: Gray) -> Vignetting:
    width = min(WIDTH_PX, gray.shape[1])
    height = max(1, round(gray.shape[0] * width / gray.shape[1]))
    if min(width, height) < 8:
        return Vignetting(side=side)
    small = np.asarray(cv2.resize(gray.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA))
    usable = (small > USABLE_DN[0]) & (small < USABLE_DN[1])
    usable = cv2.erode(usable.astype(np.uint8), np.ones((3, 3)))[1:-1, 1:-1] > 0
    if np.count_nonzero(usable) < LEAST_POINTS:
        return Vignetting(side=side)
    logs = np.log(small + np.float32(LOG_FLOOR_DN))
    across, down = (logs[1:-1, 2:] - logs[1:-1, :-2]) / 2, (logs[2:, 1:-1] - logs[:-2, 1:-1]) / 2
    half = np.hypot(width, height) / 2
    y, x = np.mgrid[1 : height - 1, 1 : width - 1]
    x, y = (x - (width - 1) / 2) / half, (y - (height - 1) / 2) / half
    zero, one = np.zeros(int(usable.sum())), np.ones(int(usable.sum()))
    # log brightness = -falloff (x^2 + y^2) + a x + b y, so that its gradient per px is -2 falloff x / half + a / half.
    design = (
        np.concatenate([np.stack([-2 * x[usable], one, zero], axis=1), np.stack([-2 * y[usable], zero, one], axis=1)])
        / half
    )
    values = np.concatenate([across[usable], down[usable]]).astype(np.float64)
    coefficients, covariance, _ = fit_linear(design, values, SCALE_FLOOR)
    sigma = float(np.hypot(CORRELATED * np.sqrt(max(covariance[0, 0], 0.0)), MODEL_ERROR))
    return Vignetting(side=side, falloff=float(coefficients[0]), falloff_sigma=sigma)


PROBE = Probe(
    "measurement.vignetting",
    (Vignetting,),
    measure_vignetting,
    "medium",
    "pair",
    "Estimates the fall-off of each image towards its corners from its own gradients.",
)
