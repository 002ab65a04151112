"""Refinement of disparities by the intensities around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modules.matching.kernels.compiler import kernel

# Refinement by intensities; the values suit rendered terrain and the development pairs alike.
SMOOTH_LIMIT = 0.25  # largest change by the mean of the neighbours, px
STEP_LIMIT = 0.3  # largest change by the intensities, px
LEAST_GAIN = 0.25  # least ratio of contrast between the images, and inverse of the largest
PRIOR_SIGMA = 0.1  # expected error before the step, px
NOISE_VARIANCE = 1.0  # least variance of an intensity, DN^2
MISFIT_WEIGHT = 5.0  # counts the remaining misfit as noise; more than 1, because neighbours err alike


@kernel
def smooth_rows(disparity: NDArray[np.float32], radius: int, start: int, stop: int, out: NDArray[np.float32]) -> None:
    """Fill rows of `out` with disparities moved towards the mean of their neighbours, at most by `SMOOTH_LIMIT`.

    Only neighbours of similar disparity count, and near an edge, where they are few, they count less.
    """
    rows, columns = disparity.shape
    one, zero = np.float32(1.0), np.float32(0.0)
    number = np.empty(columns, np.float32)
    total = np.empty(columns, np.float32)
    for y in range(start, stop):
        number[:] = zero
        total[:] = zero
        for dy in range(-radius, radius + 1):
            yy = y + dy
            if yy < 0 or yy >= rows:
                continue
            for dx in range(-radius, radius + 1):
                begin, end = max(0, -dx), min(columns, columns - dx)
                here = disparity[y, begin:end]
                there = disparity[yy, begin + dx : end + dx]
                n = number[begin:end]
                s = total[begin:end]
                for x in range(here.shape[0]):
                    step = there[x] - here[x]
                    weight = one if abs(step) < one else zero
                    n[x] += weight
                    s[x] += weight * step
        limit = np.float32(SMOOTH_LIMIT)
        square = np.float32((2 * radius + 1) ** 4)
        for x in range(columns):
            out[y, x] = disparity[y, x] + min(max(total[x] * number[x] / square, -limit), limit)


@kernel
def fit_rows(
    left: NDArray[np.float32],
    right: NDArray[np.float32],
    slope: NDArray[np.float32],
    disparity: NDArray[np.float32],
    inside: NDArray[np.float32],
    radius: int,
    start: int,
    stop: int,
    out: NDArray[np.float32],
) -> None:
    """Fill rows of `out` with the disparity moved by one damped Gauss-Newton step.

    Model in a window: left = gain (right - slope step) + offset, over the neighbours of similar disparity whose match
    lies inside the right image; beyond its border there is nothing to compare with.

    Parameters
    ----------
    left, right : float32 (H, W)
        Intensities, the right ones warped by `disparity`, DN.
    slope : float32 (H, W)
        Derivative of the right image there, DN/px.
    disparity : float32 (H, W)
        px.
    inside : float32 (H, W)
        The same, infinite where the match lies outside the right image.
    radius : int
        Half side of the window, px.
    start, stop : int
    out : float32 (H, W)
    """
    rows, columns = disparity.shape
    one, zero = np.float32(1.0), np.float32(0.0)
    sums = np.empty((10, columns), np.float32)
    for y in range(start, stop):
        sums[:] = zero
        for dy in range(-radius, radius + 1):
            yy = y + dy
            if yy < 0 or yy >= rows:
                continue
            for dx in range(-radius, radius + 1):
                begin, end = max(0, -dx), min(columns, columns - dx)
                d0, l0, r0 = disparity[y, begin:end], left[y, begin:end], right[y, begin:end]
                d1 = inside[yy, begin + dx : end + dx]
                l1 = left[yy, begin + dx : end + dx]
                r1 = right[yy, begin + dx : end + dx]
                g1 = slope[yy, begin + dx : end + dx]
                part = sums[:, begin:end]
                for x in range(d0.shape[0]):
                    weight = one if abs(d1[x] - d0[x]) < one else zero
                    a = weight * (l1[x] - l0[x])  # from the centre, so that sums of squares stay exact
                    b = weight * (r1[x] - r0[x])
                    c = weight * g1[x]
                    part[0, x] += weight
                    part[1, x] += a
                    part[2, x] += b
                    part[3, x] += c
                    part[4, x] += a * a
                    part[5, x] += b * b
                    part[6, x] += c * c
                    part[7, x] += a * b
                    part[8, x] += a * c
                    part[9, x] += b * c
        for x in range(columns):
            n = max(sums[0, x], one)  # nothing counts around a match outside the image
            aa = sums[4, x] - sums[1, x] * sums[1, x] / n
            bb = sums[5, x] - sums[2, x] * sums[2, x] / n
            cc = sums[6, x] - sums[3, x] * sums[3, x] / n
            ab = sums[7, x] - sums[1, x] * sums[2, x] / n
            ac = sums[8, x] - sums[1, x] * sums[3, x] / n
            bc = sums[9, x] - sums[2, x] * sums[3, x] / n
            gain = one
            determinant = bb * cc - bc * bc
            if determinant > np.float32(1e-3) * bb * cc:
                gain = (ab * cc - ac * bc) / determinant
                gain = min(max(gain, np.float32(LEAST_GAIN)), np.float32(1.0 / LEAST_GAIN))
            pull = gain * (gain * bc - ac)
            hold = gain * gain * cc
            misfit = aa - np.float32(2.0) * gain * ab + gain * gain * bb
            if hold > np.float32(1e-6):
                misfit -= pull * pull / hold
            variance = np.float32(NOISE_VARIANCE) + np.float32(MISFIT_WEIGHT) * max(misfit, zero) / n
            step = pull / (hold + variance / np.float32(PRIOR_SIGMA * PRIOR_SIGMA))
            out[y, x] = disparity[y, x] + min(max(step, np.float32(-STEP_LIMIT)), np.float32(STEP_LIMIT))
