"""The row misalignment of a pair: model, robust fit and the map that undoes it.

A point at column x, row y of the right image lies `a + b (x - cx) + c (y - cy)` rows below its match in the left image,
where (cx, cy) is the image centre. `a` is an offset, `b` the tangent of a roll of the right image, `c` a row scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modules.primitives.statistics import fit_linear, median, robust_sigma
from modules.types import Correspondences

SAMPLES = 200  # of three matches


@dataclass(frozen=True)
class RowModel:
    """Row misalignment of the right image: offset at the centre (px), roll (rad), row scale (1, 0 is none)."""

    offset_px: float = 0.0
    roll_rad: float = 0.0
    scale: float = 0.0

    def rows_below(
        self, x_px: NDArray[np.floating], y_px: NDArray[np.floating], shape: tuple[int, int]
    ) -> NDArray[np.float64]:
        """Return how many rows points of the right image lie below their matches, px."""
        cx, cy = centre(shape)
        return np.asarray(self.offset_px + np.tan(self.roll_rad) * (x_px - cx) + self.scale * (y_px - cy))

    def max_abs_px(self, shape: tuple[int, int]) -> float:
        """Return the largest misalignment over an image of `shape`, px."""
        height, width = shape
        x = np.array([0.0, width - 1, 0, width - 1])
        y = np.array([0.0, 0, height - 1, height - 1])
        return float(np.abs(self.rows_below(x, y, shape)).max())

    def rms_px(self, shape: tuple[int, int]) -> float:
        """Return the root mean square misalignment over an image of `shape`, px."""
        height, width = shape
        squares = np.tan(self.roll_rad) ** 2 * (width**2 - 1) + self.scale**2 * (height**2 - 1)
        return float(np.sqrt(self.offset_px**2 + squares / 12))  # (n^2 - 1) / 12: variance of n equal steps


@dataclass(frozen=True)
class RowFit:
    """A fitted `RowModel` and how far it can be trusted."""

    model: RowModel
    inliers: NDArray[np.bool_]
    residual_px: float
    sigma_px: float  # standard error of the offset
    sigma_roll_rad: float
    sigma_scale: float


def centre(shape: tuple[int, int]) -> tuple[float, float]:
    """Return the column and row of the image centre, px."""
    return (shape[1] - 1) / 2, (shape[0] - 1) / 2


def fit_rows(matches: Correspondences, shape: tuple[int, int]) -> RowFit | None:
    """Fit the row model to matches with many outliers.

    Starts from the most frequent row difference, takes the best of 200 seeded samples of three matches, and refines by
    reweighted least squares.

    Returns
    -------
    RowFit or None
        None with fewer than 8 matches that agree.

    References
    ----------
    M. A. Fischler and R. C. Bolles, Random sample consensus, CACM 1981.
    """
    if len(matches) < 8:
        return None
    cx, cy = centre(shape)
    x, y = matches.right_xy[:, 0].astype(np.float64), matches.right_xy[:, 1].astype(np.float64)
    dy = y - matches.left_xy[:, 1]
    design = np.stack([np.ones_like(x), (x - cx) / max(cx, 1), (y - cy) / max(cy, 1)], axis=1)
    window = max(3.0, 0.02 * shape[0])
    near = _densest(dy, window)
    if np.count_nonzero(near) < 8:
        return None
    start = _sample_consensus(design[near], dy[near])
    close = np.abs(dy - design @ start) < 1.5
    if np.count_nonzero(close) < 8:
        return None
    coefficients, covariance, _ = fit_linear(design[close], dy[close], 0.02)
    residual = dy - design @ coefficients
    inliers = np.abs(residual) < max(3 * robust_sigma(residual[close]), 0.3)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0))
    model = RowModel(
        float(coefficients[0]),
        float(np.arctan(coefficients[1] / max(cx, 1))),
        float(coefficients[2] / max(cy, 1)),
    )
    return RowFit(
        model,
        inliers,
        robust_sigma(residual[inliers]),
        float(sigma[0]),
        float(sigma[1] / max(cx, 1)),
        float(sigma[2] / max(cy, 1)),
    )


def _densest(values: NDArray[np.float64], half_width: float) -> NDArray[np.bool_]:
    ordered = np.sort(values)
    counts = np.searchsorted(ordered, ordered + 2 * half_width, side="right") - np.arange(len(ordered))
    low = ordered[int(np.argmax(counts))]
    return np.asarray((values >= low) & (values <= low + 2 * half_width))


def _sample_consensus(design: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    first, *others = np.random.default_rng(0).integers(len(values), size=(SAMPLES, 3)).T
    (dx1, dy1), (dx2, dy2) = ((design[other] - design[first]).T[1:] for other in others)
    dv1, dv2 = (values[other] - values[first] for other in others)
    determinant = dx1 * dy2 - dx2 * dy1
    wide = np.abs(determinant) > 0.05  # also drops a match that was drawn twice
    across = (dv1 * dy2 - dv2 * dy1)[wide] / determinant[wide]
    down = (dx1 * dv2 - dx2 * dv1)[wide] / determinant[wide]
    start = values[first][wide] - across * design[first, 1][wide] - down * design[first, 2][wide]
    candidates = np.vstack([[median(values), 0.0, 0.0], np.column_stack([start, across, down])])
    off = candidates @ design.T
    off -= values
    close = len(values) - np.minimum(np.abs(off, out=off), 1, out=off).sum(axis=1)
    steep = np.abs(candidates[:, 1:]).max(axis=1)
    return np.asarray(candidates[int(np.argmax(close * (1 - 0.01 * np.minimum(steep, 50.0))))])
