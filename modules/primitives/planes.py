"""Robust fits of planes z = a x + b y + c."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SAMPLE_POINTS = 2000  # points on which the hypotheses of the random search are scored
HYPOTHESES = 300  # 99.9 % sure of one clean triple at 28 % inliers
SEED = 20140303  # the search is random but always the same


@dataclass(frozen=True)
class PlaneFit:
    """A plane `z = a x + b y + c` and how well it fits.

    Attributes
    ----------
    coefficients : float64 (3,)
        a, b, c.
    inliers : bool (N,)
        Points within the tolerance.
    residual : float
        Root of the mean squared residual of the inliers, unit of z.
    """

    coefficients: NDArray[np.float64]
    inliers: NDArray[np.bool_]
    residual: float

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return z of the plane at x, y."""
        a, b, c = self.coefficients
        return a * x + b * y + c


def least_squares_plane(
    xy: NDArray[np.float64], z: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a, b, c (3,) of the plane that minimises the weighted squared residuals of z over points (N, 2), (N,)."""
    x, y = [np.ascontiguousarray(part) for part in xy.T]
    centre = float(x.mean()), float(y.mean())
    x, y, one = x - centre[0], y - centre[1], np.ones_like(x)
    # Normal equations: three unknowns of about the same size about the centre need no orthogonal factors. By einsum:
    # the threads of a BLAS library gain nothing here, and spin when they have nothing to do.
    rows = [part * weights for part in (x, y, one)]
    normal = [[np.einsum("n,n->", row, part) for part in (x, y, one)] for row in rows]
    a, b, c = np.linalg.lstsq(normal, [np.einsum("n,n->", row, z) for row in rows], rcond=1e-12)[0]
    return np.array([a, b, c - a * centre[0] - b * centre[1]])


def robust_plane(
    xy: NDArray[np.float64], z: NDArray[np.float64], tolerance: NDArray[np.float64] | float
) -> PlaneFit | None:
    """Fit a plane to the largest set of points that agree with one, then refine it on that set.

    Parameters
    ----------
    xy : float64 (N, 2)
        Independent coordinates.
    z : float64 (N,)
        Dependent coordinate.
    tolerance : float or float64 (N,)
        A point agrees when its residual in z is at most this; also the inverse weight of the refinement.

    Returns
    -------
    PlaneFit or None
        None when fewer than three points are not on one line.

    References
    ----------
    M. Fischler and R. Bolles, "Random sample consensus", Communications of the ACM 24 (1981); score after P. Torr and
    A. Zisserman, "MLESAC", Computer Vision and Image Understanding 78 (2000).
    """
    count = len(z)
    if count < 3:
        return None
    limit = np.broadcast_to(np.asarray(tolerance, np.float64), (count,))
    rng = np.random.default_rng(SEED)
    sample = rng.choice(count, min(count, SAMPLE_POINTS), replace=False, shuffle=False)
    sxy, sz, slimit = xy[sample], z[sample], limit[sample]
    triples = rng.integers(0, len(sample), (HYPOTHESES, 3))
    design = np.concatenate([sxy[triples], np.ones((HYPOTHESES, 3, 1))], axis=2)
    scale = float(np.ptp(sxy, axis=0).max()) ** 2
    usable = np.abs(np.linalg.det(design)) > 1e-6 * scale
    if not usable.any():
        return None
    planes = np.linalg.solve(design[usable], sz[triples[usable]][..., None])[..., 0]
    best = planes[np.argmin(_misfits(planes, sxy, sz, slimit))]
    some, everything = (sxy, sz, slimit), (xy, z, limit)
    for points, heights, most in (some, some, some, everything, everything):
        inliers = np.abs(_height(best, points) - heights) <= most
        if np.count_nonzero(inliers) < 3:
            return None
        best = least_squares_plane(points[inliers], heights[inliers], 1.0 / most[inliers] ** 2)
    residual = _height(best, xy) - z
    inliers = np.abs(residual) <= limit
    rms = float(np.sqrt(np.mean(residual[inliers] ** 2))) if inliers.any() else float("inf")
    return PlaneFit(best, inliers, rms)


def _height(coefficients: NDArray[np.float64], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return z (N,) of a plane at points (N, 2)."""
    a, b, c = coefficients
    return np.asarray(a * xy[:, 0] + b * xy[:, 1] + c)


def _misfits(
    planes: NDArray[np.float64], xy: NDArray[np.float64], z: NDArray[np.float64], limit: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the sum (K,) of how far points (N, 2), (N,) lie off each plane (K, 3), in limits and at most 1 each."""
    centre, middle = xy.mean(axis=0), z.mean()  # single precision suffices about the centre
    x, y, one = (np.asarray(part / limit, np.float32) for part in (*(xy - centre).T, np.ones_like(z)))
    height = np.asarray((z - middle) / limit, np.float32)
    slopes = planes[:, :2].astype(np.float32)
    offsets = (_height(planes.T, centre[None]) - middle).astype(np.float32)
    found = np.empty(len(planes), np.float32)
    for k, (a, b) in enumerate(slopes):
        found[k] = np.minimum(np.abs(a * x + b * y + (offsets[k] * one - height)), np.float32(1.0)).sum()
    return found
