"""How corresponding points differ in brightness, and which camera model explains it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from modules.measurement._corresponding import (
    CORRELATED,
    LOG_FLOOR_DN,
    Corresponding,
    exponent_within_patches,
    log_ratio,
)
from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.primitives.statistics import Floats, fit_linear, median, percentiles, robust_sigma
from modules.probe import FactModel, Probe, quantity

CORE = (3.0, 97.0)  # percentiles of the left brightness between which the tone curve is fitted
BEYOND = 1.3  # half ranges from their middle where the curve goes on as a straight line
# What the models themselves are wrong by on real pairs, where gloss and parallax act: see docs/facts_validation.md.
GAIN_ERROR, OFFSET_ERROR_DN, DIFFERENCE_ERROR_DN, GAMMA_ERROR, CAST_ERROR = 0.015, 2.0, 1.2, 0.035, 0.015
KEPT_PERCENT = 85  # of squared residuals; larger ones are wrong matches and count as this one
LOCAL_GAMMA_ERROR = (0.01, 0.15)  # absolute, and of the distance from 1: blocks near edges of light flatten it
PATCHY = 0.06  # of `LightFit.patchy`; tone curves are not to be trusted under light that differs this much
CAST_DN = 20.0  # darker blocks say little about colour
CAST_BLOCKS = 60


def _residual(description: str) -> Any:
    text = f"Root mean square of right minus left, {description}; place removed"
    return quantity(text, unit="dn", ge=0, resolution=0.01, default=None)


class Radiometry(FactModel):
    """Differences of corresponding blocks; only the count where too few correspond."""

    template: ClassVar[str] = "radiometry"

    count: int = quantity("Corresponding blocks that are neither clipped nor black", ge=0)
    difference_dn: float | None = quantity(
        "Median of right minus left, place removed",
        unit="dn",
        resolution=0.01,
        sigma="difference_sigma_dn",
        default=None,
    )
    difference_sigma_dn: float | None = quantity(
        "Standard error of the difference", unit="dn", ge=0, resolution=0.01, default=None
    )
    gain: float | None = quantity(
        "Gain of the right image relative to the left one", resolution=0.001, sigma="gain_sigma", default=None
    )
    gain_sigma: float | None = quantity("Standard error of the gain", ge=0, resolution=0.001, default=None)
    offset_dn: float | None = quantity(
        "Right image minus gain times left image",
        unit="dn",
        resolution=0.01,
        sigma="offset_sigma_dn",
        default=None,
    )
    offset_sigma_dn: float | None = quantity(
        "Standard error of the offset", unit="dn", ge=0, resolution=0.01, default=None
    )
    gamma: float | None = quantity(
        "Exponent of the right image over that of the left one, beside a gain",
        resolution=0.001,
        sigma="gamma_sigma",
        default=None,
    )
    gamma_sigma: float | None = quantity("Standard error of the exponent", ge=0, resolution=0.001, default=None)
    local_gamma: float | None = quantity(
        "The same from contrasts within patches, where light that differs from place to place cancels; an offset of "
        "20 dn looks like 0.85",
        resolution=0.001,
        sigma="local_gamma_sigma",
        default=None,
    )
    local_gamma_sigma: float | None = quantity(
        "Standard error of the exponent within patches", ge=0, resolution=0.001, default=None
    )
    constancy_residual_dn: float | None = _residual("equal brightness assumed")
    gain_residual_dn: float | None = _residual("after a gain alone")
    offset_residual_dn: float | None = _residual("after an offset alone")
    gamma_residual_dn: float | None = _residual("after an exponent alone")
    line_residual_dn: float | None = _residual("after gain and offset")
    curve_residual_dn: float | None = _residual("after gain and exponent")
    cast_fraction: float | None = quantity(
        "Largest minus smallest log ratio of a colour channel beyond what one tone curve for all gives",
        ge=0,
        resolution=0.001,
        sigma="cast_sigma",
        default=None,
    )
    cast_sigma: float | None = quantity("Standard error of the cast", ge=0, resolution=0.001, default=None)
    log_ratio_spread: float | None = quantity(
        "Robust standard deviation of the log ratio of corresponding blocks", ge=0, resolution=0.001, default=None
    )


def measure_radiometry(sample: Sample) -> list[Radiometry]:
    """Return the one `radiometry` fact of the pair.

    What changes with place (vignetting, a gradient) is taken out first, so that gain, offset and exponent are those at
    the centre of the image.
    """
    blocks, light = sample.blocks, sample.light
    if blocks is None or light is None:
        return [Radiometry(count=0)]
    left = blocks.left
    right = _undo(blocks.right, light.place)
    low, high = percentiles(left, CORE)
    middle, half = (low + high) / 2, max((high - low) / 2, 1.0)
    at = (left - middle) / half
    line = np.column_stack([np.ones_like(at), at])
    straight, straight_covariance, _ = fit_linear(line, right, 0.5)
    bent, _, _ = fit_linear(np.column_stack([line, at**2 - 1 / 3]), right, 0.5)
    logs = np.column_stack([np.ones_like(at), np.log((left + 0.5) / 255.5)])
    weight = right / 100  # of a log residual in dn
    power, power_covariance, _ = fit_linear(logs * weight[:, None], np.log((right + 0.5) / 255.5) * weight, 0.005)
    gain = float(straight[1] / half)
    errors = CORRELATED * np.sqrt(np.maximum(np.diag(straight_covariance), 0))
    local = exponent_within_patches(blocks)
    by_curve = _ToneCurve(bent, middle, half).log_ratio
    if light.patchy >= PATCHY:  # no curve fits all of the image
        power_beyond_1 = local[0] - 1 if local else 0.0
        by_curve = partial(_power_ratio, power_beyond_1)
    cast, cast_sigma = _cast(blocks, by_curve, (middle - BEYOND * half, middle + BEYOND * half))
    return [
        Radiometry(
            count=len(blocks),
            difference_dn=median(right - left),
            difference_sigma_dn=float(np.hypot(_median_error(right - left), DIFFERENCE_ERROR_DN)),
            gain=gain,
            gain_sigma=float(np.hypot(errors[1] / half, GAIN_ERROR)),
            offset_dn=float(straight[0] - gain * middle),
            offset_sigma_dn=float(np.linalg.norm([errors[0], errors[1] * middle / half, OFFSET_ERROR_DN])),
            gamma=float(power[1]),
            gamma_sigma=float(np.hypot(CORRELATED * np.sqrt(max(power_covariance[1, 1], 0)), GAMMA_ERROR)),
            local_gamma=local[0] if local else None,
            local_gamma_sigma=_local_gamma_sigma(*local) if local else None,
            constancy_residual_dn=_rms(right - left),
            gain_residual_dn=_rms(right - median(right / left) * left),
            offset_residual_dn=_rms(right - left - median(right - left)),
            gamma_residual_dn=_rms(right - 255 * (left / 255) ** _exponent(left, right)),
            line_residual_dn=_rms(right - line @ straight),
            curve_residual_dn=_rms(right - (255.5 * np.exp(logs @ power) - 0.5)),
            cast_fraction=cast,
            cast_sigma=cast_sigma,
            log_ratio_spread=robust_sigma(log_ratio(left, blocks.right)),
        )
    ]


def _local_gamma_sigma(exponent: float, sigma: float) -> float:
    return float(np.hypot(sigma, LOCAL_GAMMA_ERROR[0] + LOCAL_GAMMA_ERROR[1] * abs(exponent - 1)))


def _power_ratio(beyond_1: float, levels: Floats) -> Floats:
    return np.asarray(beyond_1 * np.log(levels + LOG_FLOOR_DN))


def _undo(values: NDArray[Any], place: Floats) -> Floats:
    return np.asarray((values + LOG_FLOOR_DN) * np.exp(-place) - LOG_FLOOR_DN).clip(0.5, None)


def _rms(residual: Floats) -> float:
    squares = residual * residual
    return float(np.sqrt(np.mean(np.minimum(squares, percentiles(squares, [KEPT_PERCENT])))))


def _median_error(values: Floats) -> float:
    return float(CORRELATED * 1.2533 * robust_sigma(values) / np.sqrt(len(values)))  # 1.2533: median against mean


def _exponent(left: Floats, right: Floats) -> float:
    exponents = np.log((right + 0.5) / 255.5) / np.minimum(np.log((left + 0.5) / 255.5), -0.05)
    return median(exponents)


@dataclass(frozen=True)
class _ToneCurve:
    """A parabola of the left brightness, in half ranges from the middle, that goes on as a straight line."""

    coefficients: Floats
    middle: float
    half: float

    def log_ratio(self, levels: Floats) -> Floats:
        """Return the log ratio that the curve makes of levels, up to a constant."""
        at = (levels - self.middle) / self.half
        core = np.clip(at, -BEYOND, BEYOND)
        height, slope, bend = self.coefficients
        mapped = height + slope * core + bend * (core**2 - 1 / 3) + (slope + 2 * bend * core) * (at - core)
        return log_ratio(levels, np.maximum(mapped, 0.5))


def _cast(
    blocks: Corresponding, by_curve: Callable[[Floats], Floats], limits_dn: tuple[float, float]
) -> tuple[float | None, float | None]:
    """Compare the log ratio of each channel with that of the luminance, where light cancels; less what a curve does.

    Levels of the left image beyond `limits_dn` are left out: the curve says little there.
    """
    if blocks.left_colour is None or blocks.right_colour is None:
        return None, None
    expected = by_curve(blocks.left)
    common = log_ratio(blocks.left, blocks.right)
    excess, errors = [], []
    for channel in range(3):
        left, right = blocks.left_colour[:, channel], blocks.right_colour[:, channel]
        use = (left > max(CAST_DN, limits_dn[0])) & (right > CAST_DN) & (left < limits_dn[1])
        if np.count_nonzero(use) < CAST_BLOCKS:
            return None, None
        beyond = (log_ratio(left, right) - by_curve(left) - common + expected)[use]
        excess.append(median(beyond))
        errors.append(_median_error(beyond))
    _, second, largest = sorted(errors)
    return max(excess) - min(excess), float(np.linalg.norm([second, largest, CAST_ERROR]))


PROBE = Probe(
    "measurement.radiometry",
    (Radiometry,),
    measure_radiometry,
    "medium",
    "pair",
    "Compares the brightness of corresponding points: gain, offset, exponent, cast, and what each model leaves.",
    cost=Cost(fixed_ms=7, ns_per_pixel=2),
)
