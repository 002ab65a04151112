"""Noise of one image plane."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.statistics import Floats, fit_linear, median, percentiles

FILTER = np.array([1.0, -2.0, 1.0])  # along both axes: a plane and an edge along an axis give no response
FILTER_GAIN = 6.0  # root of the sum of squares of the filter's outer product with itself
BLOCK_PX = 16
LOW_PERCENT = 15.0  # smoothest blocks; texture fills the others
STRIP_PX = 64  # rows that are filtered at once; of large images only every second or third strip is
ENOUGH_PX = 150_000  # pixels that suffice
LOW_BIAS = 0.93  # mean of |Laplacian| in the smoothest 15 % of pure-noise blocks relative to all
USABLE_DN = (4.0, 250.0)  # block means beyond hold clipped or black pixels, which carry no noise
LEAST_BLOCKS = 10
LEVEL_GROUPS = 12  # of equally many blocks, by level; the smoothest blocks of each tell its noise
LEAST_GROUPS = 4
GROUP_BLOCKS = 12  # fewer blocks do not make a group
LEVEL_SPAN_DN = 30.0  # between the darkest and the brightest group, or nothing can be said of the slope
GROUP_ERROR = 0.15  # relative error of the variance of one group, texture included
TEXTURE_ERROR = 0.25  # of the variance; even the smoothest blocks of a level may hold texture
ROUNDING_DN2 = 1 / 12  # variance that rounding to levels adds; smaller differences mean nothing


@dataclass(frozen=True)
class NoiseBlocks:
    """Strength of the Laplacian and mean level of square blocks, none of them clipped or black.

    Attributes
    ----------
    sigma_dn : float32 (N,)
        Standard deviation of the noise if there were nothing but noise; texture adds to it.
    level_dn : float32 (N,)
        Mean.
    """

    sigma_dn: NDArray[np.float32]
    level_dn: NDArray[np.float32]

    @property
    def noise_dn(self) -> float:
        """Noise by the smoothest blocks; 0 with fewer than 10 blocks."""
        if self.sigma_dn.size < LEAST_BLOCKS:
            return 0.0
        return float(percentiles(self.sigma_dn, [LOW_PERCENT])[0]) / LOW_BIAS


@dataclass(frozen=True)
class NoiseLine:
    """Variance of the noise against the level, `floor + slope * level`, with standard errors; see `fit_noise_line`."""

    floor_dn2: float
    floor_sigma_dn2: float
    slope_dn: float
    slope_sigma_dn: float


def noise_blocks(plane: NDArray[np.uint8]) -> NoiseBlocks:
    """Return the strength of the Laplacian by block.

    Parameters
    ----------
    plane : uint8 (H, W)

    References
    ----------
    J. Immerkaer, Fast noise variance estimation, CVIU 64(2), 1996.
    """
    if min(plane.shape) < 3 * BLOCK_PX:
        none = np.zeros(0, np.float32)
        return NoiseBlocks(none, none)
    step = STRIP_PX * max(1, plane.size // ENOUGH_PX)
    strips = [plane[row : row + STRIP_PX] for row in range(0, plane.shape[0] - BLOCK_PX + 1, step)]
    strength, level = (np.concatenate(parts) for parts in zip(*map(_blocks, strips), strict=True))
    usable = (level > USABLE_DN[0]) & (level < USABLE_DN[1])
    scale = np.float32(np.sqrt(np.pi / 2) / FILTER_GAIN)  # mean of |Laplacian| to standard deviation
    return NoiseBlocks(strength[usable] * scale, level[usable])


def estimate_noise_dn(plane: NDArray[np.uint8]) -> float:
    """Estimate the noise of one plane (H, W) from the Laplacian of its smoothest blocks, dn."""
    return noise_blocks(plane).noise_dn


def fit_noise_line(blocks: NoiseBlocks) -> NoiseLine | None:
    """Fit a straight line to the variance of the noise against the level.

    Photons arrive at random, so that the variance grows in proportion to the light, on top of a floor that the
    electronics give. Groups of blocks of like level are told by their smoothest; where all blocks of a group hold
    texture it lies above the line and weighs little.

    Returns
    -------
    NoiseLine or None
        None where the levels span too little, or only texture is left.

    References
    ----------
    A. Foi, M. Trimeche, V. Katkovnik, K. Egiazarian, Practical Poissonian-Gaussian noise modeling and fitting for
    single-image raw-data, IEEE TIP 17(10), 2008.
    """
    count = min(LEVEL_GROUPS, blocks.level_dn.size // GROUP_BLOCKS)
    if count < LEAST_GROUPS:
        return None
    order = np.argsort(blocks.level_dn, kind="stable")
    groups = np.array_split(order, count)
    level = np.array([float(blocks.level_dn[group].mean()) for group in groups])
    smooth = np.array([float(percentiles(blocks.sigma_dn[group], [LOW_PERCENT])[0]) for group in groups])
    if np.ptp(level) < LEVEL_SPAN_DN:
        return None
    variance = (smooth / LOW_BIAS) ** 2
    floor, slope, errors = _line(level, variance)
    while slope < -2 * errors[1]:  # light never lowers the variance: the darker groups hold texture
        level, variance = level[1:], variance[1:]
        if len(level) < LEAST_GROUPS or np.ptp(level) < LEVEL_SPAN_DN:
            return None
        floor, slope, errors = _line(level, variance)
    return NoiseLine(floor, float(errors[0]), slope, float(errors[1]))


def _line(level: Floats, variance: Floats) -> tuple[float, float, Floats]:
    """Return the floor and the slope of the variance, and their standard errors."""
    weight = 1 / (GROUP_ERROR * variance + ROUNDING_DN2)
    design = np.column_stack([np.ones_like(level), level]) * weight[:, None]
    (floor, slope), covariance, _ = fit_linear(design, variance * weight, 1.0)
    model = TEXTURE_ERROR * median(variance)
    falling = max(0.0, -float(slope)) * median(level)  # by texture: the floor may be as much lower
    errors = np.hypot(np.sqrt(np.maximum(np.diag(covariance), 0)), [model + falling, model / np.ptp(level)])
    return float(floor), float(slope), errors


def _blocks(strip: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the mean of |Laplacian| and the mean level of each block, flat."""
    response = np.abs(np.asarray(cv2.sepFilter2D(strip, cv2.CV_16S, FILTER, FILTER)))
    size = (strip.shape[1] // BLOCK_PX, strip.shape[0] // BLOCK_PX)
    crop = (slice(0, size[1] * BLOCK_PX), slice(0, size[0] * BLOCK_PX))
    strength, level = (
        cv2.resize(plane[crop].astype(np.float32), size, interpolation=cv2.INTER_AREA) for plane in (response, strip)
    )
    return np.asarray(strength, np.float32).ravel(), np.asarray(level, np.float32).ravel()
