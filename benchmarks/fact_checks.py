"""Differences of known size, and what the facts should say of them: the list that `benchmarks.facts` goes through."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from benchmarks.causes import Damage, dead_columns, gradient, motion, sensor, stuck_pixels
from modules.catalog import probes
from modules.measurement.sample import Sample
from modules.measurement.scene import Scene
from modules.probe import FactModel
from modules.types import Image, Side, Views, full_scale


@dataclass(frozen=True)
class Check:
    """One difference of known size, and the field that shall tell it.

    Attributes
    ----------
    probe, field : str
        The fact; `field_sigma` is its uncertainty, where there is one.
    what : str
        The difference, for the table.
    damage : Damage
        Of the image `side`.
    truth : float or callable
        What the field should say, or how it follows from the image, the seed and the undamaged image.
    sigma : str, optional
        Field of the uncertainty.
    side : str
        Image that is damaged; of probes that tell the images apart, the fact that is read.
    """

    probe: str
    field: str
    what: str
    damage: Damage
    truth: float | Callable[[Image, int], float]
    sigma: str | None = None
    side: Side = "right"


def radial_truth(loss: float) -> Callable[[Image, int], float]:
    """Return the slope of the log light over the squared radius: what a straight line makes of vignetting."""

    def truth(image: Image, seed: int) -> float:
        rows, columns = image.shape[:2]
        y, x = np.mgrid[:rows:4, :columns:4]
        r2 = ((x - columns / 2) ** 2 + (y - rows / 2) ** 2) / ((columns**2 + rows**2) / 4)
        return float(np.polyfit(r2.ravel(), np.log(1 - loss * r2).ravel(), 1)[0])

    return truth


def minus(truth: Callable[[Image, int], float]) -> Callable[[Image, int], float]:
    """Return a truth with the other sign."""
    return lambda image, seed: -truth(image, seed)


def gradient_truth(image: Image, seed: int) -> float:
    """Return the magnitude of the gradient that `gradient` makes, over half the diagonal."""
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi)
    rows, columns = image.shape[:2]
    half = np.hypot(rows, columns) / 2
    return float(0.3 * half * np.hypot(np.cos(angle) / (columns / 2), np.sin(angle) / (rows / 2)))


def clipped_truth(image: Image, seed: int) -> float:
    """Return how many pixels a gain of 1.6 brings to full scale."""
    bright = image if image.ndim == 2 else image.max(axis=2)
    scale = full_scale(image) / 255
    return float(np.mean(np.rint(1.6 * bright / scale) >= 254) - np.mean(bright / scale >= 254))


def motion_truth(image: Image, seed: int) -> float:
    """Return the direction that `motion` draws, between -90 and 90 degrees."""
    angle = float(np.rad2deg(np.random.default_rng(seed).uniform(0, np.pi)))
    return (angle + 90) % 180 - 90


def sixteen_levels(image: Image, strength: float, seed: int) -> Image:
    """Replace the image by squares of 2 px of 16 equally frequent levels: 4 bits in every block."""
    rows, columns = image.shape[:2]
    levels = np.random.default_rng(seed).integers(16, size=((rows + 1) // 2, (columns + 1) // 2))
    squares = np.kron(8 + 16 * levels, np.ones((2, 2)))[:rows, :columns]
    return _like(image, squares)


def stripes(image: Image, strength: float, seed: int) -> Image:
    """Replace the image by noise smoothed by 4 px across and 12 px along a direction drawn by the seed."""
    rows, columns = image.shape[:2]
    random = np.random.default_rng(seed)
    angle, reach = random.uniform(-90, 90), 2 * max(rows, columns)
    noise = cv2.GaussianBlur(random.normal(size=(reach, reach)).astype(np.float32), (0, 0), 12.0, sigmaY=4.0)
    turn = cv2.getRotationMatrix2D((reach / 2, reach / 2), -angle, 1.0)
    turned = cv2.warpAffine(noise, turn, (reach, reach))
    first = (reach - rows) // 2, (reach - columns) // 2
    part = turned[first[0] : first[0] + rows, first[1] : first[1] + columns]
    return _like(image, np.clip(128 + 40 * part / part.std(), 0, 255))


def stripes_truth(image: Image, seed: int) -> float:
    """Return the direction that `stripes` draws."""
    return float(np.random.default_rng(seed).uniform(-90, 90))


def patch(image: Image, strength: float, seed: int) -> Image:
    """Cover the lower half of the right three fifths by one level: three tenths of the image."""
    rows, columns = image.shape[:2]
    covered = image.copy()
    covered[rows - rows // 2 :, columns - 3 * columns // 5 :] = full_scale(image) * 0.45
    return covered


def covered_truth(field: str, share: float) -> Callable[[Image, int], float]:
    """Return a share of what is no sky after `share` of the image, none of it sky, is covered by what counts."""

    def truth(image: Image, seed: int) -> float:
        scene = cast(Scene, fact_of(Views(image, image), "scene", "left"))
        of_ground = share / (1 - scene.sky_fraction)
        return of_ground + (1 - of_ground) * float(getattr(scene, field))

    return truth


def _like(image: Image, values: np.ndarray) -> Image:
    scaled = np.rint(values * (full_scale(image) / 255)).astype(image.dtype)
    return cast(Image, scaled if image.ndim == 2 else np.repeat(scaled[..., None], 3, axis=2))


def fact_of(views: Views, probe: str, side: Side) -> FactModel:
    """Return the fact of a probe, of one image where it tells them apart."""
    found = cast(list[FactModel], probes()[f"measurement.{probe}"].function(Sample(views)))
    return next(fact for fact in found if getattr(fact, "side", side) == side)


LIT = sensor(gamma=(1.4, 1.4, 1.4), spot_gain=1.6, shadow_gain=0.55)
SHOT = sensor(noise_sigma_dn=2.0, electrons_per_dn=5.0)
TURNED = sensor(shift_y_px=1.3, misalign_rad=0.003)
CHECKS: tuple[Check, ...] = (
    Check("radiometry", "gain", "gain 0.7", sensor(gain=0.7), 0.7, "gain_sigma"),
    Check("radiometry", "gain", "gain 0.7, vignetting 0.4", sensor(gain=0.7, vignetting=0.4), 0.7, "gain_sigma"),
    Check("radiometry", "gain", "gain 0.7, noise 6 dn", sensor(gain=0.7, noise_sigma_dn=6.0), 0.7, "gain_sigma"),
    Check("radiometry", "offset_dn", "offset 20 dn", sensor(offset_dn=20.0), 20.0, "offset_sigma_dn"),
    Check("radiometry", "difference_dn", "offset 20 dn", sensor(offset_dn=20.0), 20.0, "difference_sigma_dn"),
    Check("radiometry", "gamma", "exponent 1.4", sensor(gamma=(1.4, 1.4, 1.4)), 1.4, "gamma_sigma"),
    Check("radiometry", "gamma", "exponent 0.7", sensor(gamma=(0.7, 0.7, 0.7)), 0.7, "gamma_sigma"),
    Check(
        "radiometry", "cast_fraction", "channels x 1.1, 1, 0.9", sensor(cast=(1.1, 1.0, 0.9)), float(np.log(1.1 / 0.9)),
        "cast_sigma",
    ),
    Check("light_shape", "radial", "vignetting 0.4", sensor(vignetting=0.4), radial_truth(0.4), "radial_sigma"),
    Check("light_shape", "radial", "none", sensor(), 0.0, "radial_sigma"),
    Check("light_shape", "gradient", "light x 0.74 to 1.35", gradient, gradient_truth, "gradient_sigma"),
    Check("radiometry", "local_gamma", "exponent 1.4", sensor(gamma=(1.4, 1.4, 1.4)), 1.4, "local_gamma_sigma"),
    Check("radiometry", "local_gamma", "exponent 1.4, lamp and shadow", LIT, 1.4, "local_gamma_sigma"),
    Check("radiometry", "local_gamma", "none", sensor(), 1.0, "local_gamma_sigma"),
    Check("light_shape", "patchy", "none", sensor(), 0.0),
    Check("noise", "right_sigma_dn", "noise 4 dn", sensor(noise_sigma_dn=4.0), 4.0),
    Check("noise", "right_sigma_dn", "noise 10 dn", sensor(noise_sigma_dn=10.0), 10.0),
    Check("sharpness", "ratio", "none", sensor(), 1.0),
    Check("sharpness", "ratio", "gain 0.6, offset 20 dn", sensor(gain=0.6, offset_dn=20.0), 1.0),
    Check("saturation", "difference_fraction", "gain 1.6", sensor(gain=1.6), clipped_truth),
    Check("row_alignment", "offset_px", "1.3 px, 0.003 rad", TURNED, 1.3, "sigma_px"),
    Check("row_alignment", "roll_deg", "1.3 px, 0.003 rad", TURNED, 0.1719),
    Check("row_alignment", "offset_px", "12 px", sensor(shift_y_px=12.0), 12.0, "sigma_px"),
    Check("motion", "direction_deg", "9 px along a direction", motion, motion_truth),
    Check("defects", "stuck_difference_ppm", "500 stuck pixels in a million", stuck_pixels, 500.0),
    Check("defects", "lines_difference", "4 bright columns", dead_columns, 4.0),
    Check("histogram_warp", "cost", "none", sensor(), 0.0),
    Check("histogram_warp", "cost", "offset 20 dn", sensor(offset_dn=20.0), 0.0),
    Check("noise_model", "slope_dn", "5 electrons per dn, noise 2 dn", SHOT, 0.2, "slope_sigma_dn"),
    Check("noise_model", "floor_dn2", "5 electrons per dn, noise 2 dn", SHOT, 4.0, "floor_sigma_dn2"),
    Check("noise_model", "slope_dn", "noise 4 dn", sensor(noise_sigma_dn=4.0), 0.0, "slope_sigma_dn"),
    Check("noise_model", "floor_dn2", "noise 4 dn", sensor(noise_sigma_dn=4.0), 16.0, "floor_sigma_dn2"),
    Check("vignetting", "falloff", "none", sensor(), 0.0, "falloff_sigma"),
    Check("vignetting", "falloff", "vignetting 0.4", sensor(vignetting=0.4), minus(radial_truth(0.4)), "falloff_sigma"),
    Check("texture_detail", "local_entropy_bits", "16 levels", sixteen_levels, 4.0, side="left"),
    Check("texture_detail", "anisotropy", "stripes, 4 by 12 px", stripes, 0.8, side="left"),
    Check("texture_detail", "direction_deg", "stripes, 4 by 12 px", stripes, stripes_truth, side="left"),
    Check(
        "scene", "shadow_fraction", "shadow over 0.18", sensor(shadow_gain=0.3, shadow_slope=0.0),
        covered_truth("shadow_fraction", 0.18), side="left",
    ),
    Check(
        "scene", "featureless_fraction", "one level over 0.3", patch, covered_truth("featureless_fraction", 0.3),
        side="left",
    ),
)  # fmt: skip
