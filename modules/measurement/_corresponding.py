"""Brightness of corresponding blocks: how much of their difference is tone, and how much is place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.coarse import CoarseMatch
from modules.primitives.statistics import Floats, fit_linear, solve_weighted

Blocks: TypeAlias = NDArray[np.float64]

BLOCK_PX = 4  # of the thumbnail; noise and small errors of the match cancel within
LEAST_COVER = 0.5  # of a block's pixels that must have matched
USABLE_DN = (12.0, 244.0)  # block means beyond hold clipped pixels or say little about ratios
LEAST_BLOCKS = 60
LOG_FLOOR_DN = 4.0  # added before logarithms; darker pixels say little about gain
PATCH = 0.12  # side of the patches whose light is compared, in half diagonals
PATCH_BLOCKS = 6  # fewer blocks do not make a patch
BRIGHT_DN = 30.0  # patches are compared on blocks as bright as this, where half of the blocks are
SCALE_FLOOR = 0.01  # smallest robust deviation of log ratios
MODEL_ERROR = (0.025, 0.035, 0.015)  # of radial, across and down: parallax and gloss look like a little of each
USUAL_PATCHY = 0.03  # nine in ten pairs that differ by no local light read less
CLEARLY = 1.5  # patches are larger by this factor before the other image is asked
REFITTED = 1.4  # of the patchiness on the weights of another fit; a fit of its own hardly ever gives more
CORRELATED = 3.0  # standard errors of independent blocks are too small by this: neighbours err alike


@dataclass(frozen=True)
class Corresponding:
    """Means of corresponding blocks.

    Attributes
    ----------
    left, right : float64 (N,)
        Luminance, dn.
    left_colour, right_colour : float64 (N, 3) or None
        Colours, dn.
    x, y : float64 (N,)
        Place in the right image in units of half its diagonal, from the centre.
    """

    left: Blocks
    right: Blocks
    left_colour: Blocks | None
    right_colour: Blocks | None
    x: Blocks
    y: Blocks

    def __len__(self) -> int:
        """Return the number of blocks."""
        return len(self.left)


@dataclass(frozen=True)
class LightFit:
    """The log ratio of corresponding blocks, split into tone and place; see `fit_light`.

    Attributes
    ----------
    radial, across, down : float
        Log ratio of right over left that grows with the squared distance from the centre (at the corners), to the
        right and downwards (over half the diagonal).
    radial_sigma, across_sigma, down_sigma : float
        Their standard errors.
    patchy : float
        Standard deviation over patches of the log ratio that neither tone nor these shapes explain.
    place : float64 (N,)
        Log ratio by place of each block, zero at the centre of the image.
    """

    radial: float
    radial_sigma: float
    across: float
    across_sigma: float
    down: float
    down_sigma: float
    patchy: float
    place: Floats


def corresponding_blocks(match: CoarseMatch, colours: tuple[NDArray[Any], NDArray[Any]] | None) -> Corresponding | None:
    """Average corresponding pixels of the thumbnails over blocks; None where fewer than 60 blocks are left."""
    height, width = match.left.shape
    shown = match.visible()
    valid = np.isfinite(shown)
    v = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], (height, width)).copy()
    columns = np.arange(width, dtype=np.float32) - np.where(valid, shown, np.float32(0))
    images: list[NDArray[Any]] = [match.left, cv2.remap(match.right, columns, v, cv2.INTER_LINEAR)]
    if colours is not None:
        images += [colours[0], cv2.remap(colours[1], columns, v, cv2.INTER_LINEAR)]
    size = (width // BLOCK_PX, height // BLOCK_PX)
    crop = (slice(0, size[1] * BLOCK_PX), slice(0, size[0] * BLOCK_PX))
    weight = valid[crop].astype(np.float32)
    cover = cv2.resize(weight, size, interpolation=cv2.INTER_AREA)

    def average(image: NDArray[Any]) -> NDArray[np.float64]:
        shares = weight if image.ndim == 2 else weight[..., None]
        total = cv2.resize(image[crop] * shares, size, interpolation=cv2.INTER_AREA)
        return np.asarray(total / np.maximum(cover if image.ndim == 2 else cover[..., None], 1e-6), dtype=np.float64)

    means = [average(image) for image in images]
    keep = cover >= LEAST_COVER
    for mean in means:
        inside = (mean > USABLE_DN[0]) & (mean < USABLE_DN[1])
        keep &= inside if mean.ndim == 2 else inside.all(axis=2)
    if np.count_nonzero(keep) < LEAST_BLOCKS:
        return None
    half = np.hypot(width, height) / 2
    x, y = (average(values)[keep] for values in (columns - (width - 1) / 2, v - (height - 1) / 2))
    kept = [mean[keep] for mean in means]
    left_colour, right_colour = (kept[2], kept[3]) if colours is not None else (None, None)
    return Corresponding(kept[0], kept[1], left_colour, right_colour, x / half, y / half)


def log_ratio(left: Blocks, right: Blocks) -> Blocks:
    """Return the logarithm of right over left, damped where both are dark."""
    return np.asarray(np.log((right + LOG_FLOOR_DN) / (left + LOG_FLOOR_DN)))


def fit_light(blocks: Corresponding) -> LightFit:
    """Explain the log ratio by a cubic of the log brightness (any smooth tone curve) and by place.

    Both are fitted together: where bright things lie in the middle, a curve would take the place of vignetting.

    Brightness is that of the left image, or of the right one where the left one's explains clearly more: on a scene of
    one material the brightness of an image shows the light that fell into it alone, and would explain that light as a
    tone curve.
    """
    ratio, patches = log_ratio(blocks.left, blocks.right), _patches(blocks)
    design = _tone_and_place(blocks, blocks.left)
    coefficients, covariance, weights = fit_linear(design, ratio, SCALE_FLOOR)
    patchy = patches.patchiness(ratio - design @ coefficients)
    limit = CLEARLY * max(patchy, USUAL_PATCHY)
    other = _tone_and_place(blocks, blocks.right)
    # Refitting changes the patchiness of the blocks that agree with the first fit little.
    if REFITTED * patches.patchiness(ratio - other @ solve_weighted(other, ratio, weights)) > limit:
        refitted, its_covariance, _ = fit_linear(other, ratio, SCALE_FLOOR)
        its_patchy = patches.patchiness(ratio - other @ refitted)
        if its_patchy > limit:
            design, coefficients, covariance, patchy = other, refitted, its_covariance, its_patchy
    sigma = np.hypot(CORRELATED * np.sqrt(np.maximum(np.diag(covariance)[4:], 0)), MODEL_ERROR)
    radial, across, down = (float(value) for value in coefficients[4:])
    return LightFit(
        radial,
        float(sigma[0]),
        across,
        float(sigma[1]),
        down,
        float(sigma[2]),
        patchy,
        design[:, 4:] @ coefficients[4:],
    )


def _tone_and_place(blocks: Corresponding, level: Blocks) -> Floats:
    """Return the design, (N, 7): a cubic of the log brightness `level`, then the shapes of place."""
    tone = np.log(level + LOG_FLOOR_DN)
    tone = (tone - tone.mean()) / max(float(tone.std()), 1e-3)
    return np.stack(
        [np.ones_like(tone), tone, tone**2, tone**2 * tone, blocks.x**2 + blocks.y**2, blocks.x, blocks.y], axis=1
    )


def exponent_within_patches(blocks: Corresponding) -> tuple[float, float] | None:
    """Return the exponent of the right image over the left one, and its standard error, from contrasts within patches.

    Within a patch the light of both images is nearly constant, whatever it is elsewhere. A gain cancels; an offset
    looks like a weak exponent. None where fewer than 60 blocks lie in patches of at least 6.
    """
    bright = np.minimum(blocks.left, blocks.right) >= BRIGHT_DN
    if np.count_nonzero(bright) < LEAST_BLOCKS:
        return None
    left, right = np.log(blocks.left[bright]), np.log(blocks.right[bright])
    _, group, counts = np.unique(_patch_of(blocks)[bright], return_inverse=True, return_counts=True)
    large = counts[group] >= PATCH_BLOCKS
    if np.count_nonzero(large) < LEAST_BLOCKS:
        return None
    tone, ratio = (
        (values - _group_medians(values, group)[group])[large] for values in ((left + right) / 2, right - left)
    )
    # Against the mean of both logarithms errors of the two cancel; (2 + s) / (2 - s) is the exponent of that slope.
    (slope,), covariance, _ = fit_linear(tone[:, None], ratio, SCALE_FLOOR)
    slope = float(np.clip(slope, -1.8, 1.8))
    exponent = (2 + slope) / (2 - slope)
    sigma = CORRELATED * float(np.sqrt(max(covariance[0, 0], 0.0))) * 4 / (2 - slope) ** 2
    return exponent, sigma


def _patch_of(blocks: Corresponding) -> NDArray[np.int64]:
    """Return the number of the patch of each block."""
    column, row = (np.floor(place / PATCH).astype(np.int64) for place in (blocks.x, blocks.y))
    return 100 * row + column


@dataclass(frozen=True)
class _Patches:
    """Which blocks are compared by patch, the number of the patch of each, and which patches are large enough."""

    use: NDArray[np.bool_]
    group: NDArray[np.int64]
    large: NDArray[np.bool_]

    def patchiness(self, residual: Floats) -> float:
        """Return the standard deviation over patches of the median of the residual; 0 with few patches."""
        medians = _group_medians(residual[self.use], self.group)[self.large]
        return float(np.std(medians)) if len(medians) > 5 else 0.0


def _patches(blocks: Corresponding) -> _Patches:
    """Group the blocks by patch: the bright ones, where half of the blocks are."""
    bright = np.minimum(blocks.left, blocks.right) >= BRIGHT_DN
    if np.count_nonzero(bright) < len(blocks) / 2:
        bright[:] = True
    _, group, counts = np.unique(_patch_of(blocks)[bright], return_inverse=True, return_counts=True)
    return _Patches(bright, group, counts >= PATCH_BLOCKS)


def _group_medians(values: Floats, group: NDArray[np.int64]) -> Floats:
    """Return the median of each group; groups are numbered from 0 without gaps."""
    ordered = values[np.lexsort((values, group))]
    counts = np.bincount(group)
    middle = np.cumsum(counts) - counts + (counts - 1) / 2
    return np.asarray((ordered[np.floor(middle).astype(int)] + ordered[np.ceil(middle).astype(int)]) / 2)
