"""Refinement of disparities by the intensities around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modules.matching.kernels.compiler import kernel
from modules.matching.kernels.vectors import (
    FLOAT_LANES,
    add,
    floats_of,
    load,
    multiply,
    store,
    subtract,
    where_within,
)

# Refinement by intensities; the values suit rendered terrain and the development pairs alike.
SIMILAR = 1.0  # neighbours whose disparity differs less lie on one surface, px
SMOOTH_LIMIT = 0.25  # largest change by the mean of the neighbours, px
STEP_LIMIT = 0.3  # largest change by the intensities, px
LEAST_GAIN = 0.25  # least ratio of contrast between the images, and inverse of the largest
PRIOR_SIGMA = 0.1  # expected error before the step, px
NOISE_VARIANCE = 1.0  # least variance of an intensity, DN^2


@kernel
def smooth_rows(
    disparity: NDArray[np.float32],
    columns: int,
    radius: int,
    tall: int,
    start: int,
    stop: int,
    out: NDArray[np.float32],
) -> None:
    """Fill rows of `out` with disparities moved towards the mean of their neighbours, at most by `SMOOTH_LIMIT`.

    Only neighbours of similar disparity count, and near an edge, where they are few, they count less.

    Parameters
    ----------
    disparity : float32 (H, P)
        px, with margins as `refine_subpixel.room_with_margins` makes them.
    columns, radius, tall, start, stop : int
        Of the image; half width and half height of the window, px; rows to fill.
    out : float32 (H, P)
    """
    rows, pitch = disparity.shape
    flat = disparity.reshape(disparity.size)
    sums = np.empty((2, pitch + FLOAT_LANES), np.float32)
    number, total = sums[0], sums[1]
    one, near = floats_of(np.float32(1.0)), floats_of(np.float32(SIMILAR))
    limit = np.float32(SMOOTH_LIMIT)
    square = np.float32(((2 * radius + 1) * (2 * tall + 1)) ** 2)
    for y in range(start, stop):
        for x in range(radius, radius + columns, FLOAT_LANES):
            here = load(flat, y * pitch + x)
            n = s = floats_of(np.float32(0.0))
            for yy in range(max(y - tall, 0), min(y + tall, rows - 1) + 1):
                for dx in range(-radius, radius + 1):
                    step = subtract(load(flat, yy * pitch + x + dx), here)
                    n = add(n, where_within(step, near, one))
                    s = add(s, where_within(step, near, step))
            store(number, x, n)
            store(total, x, s)
        for x in range(radius, radius + columns):
            out[y, x] = disparity[y, x] + min(max(total[x] * number[x] / square, -limit), limit)


@kernel
def fit_rows(
    left: NDArray[np.float32],
    right: NDArray[np.float32],
    slope: NDArray[np.float32],
    disparity: NDArray[np.float32],
    inside: NDArray[np.float32],
    columns: int,
    radius: int,
    tall: int,
    misfit_weight: float,
    start: int,
    stop: int,
    out: NDArray[np.float32],
) -> None:
    """Fill rows of `out` with the disparity moved by one damped Gauss-Newton step.

    Model in a window: left = gain (right - slope step) + offset, over the neighbours of similar disparity whose match
    lies inside the right image; beyond its border there is nothing to compare with.

    Parameters
    ----------
    left, right : float32 (H, P)
        Intensities, the right ones warped by `disparity`, DN; like all that follows with margins as
        `refine_subpixel.room_with_margins` makes them.
    slope : float32 (H, P)
        Derivative of the right image there, DN/px.
    disparity : float32 (H, P)
        px.
    inside : float32 (H, P)
        The same, infinite where the match lies outside the right image and in the margins.
    columns, radius, tall : int
        Of the image; half width and half height of the window, px.
    misfit_weight : float
        Counts the remaining misfit as noise.
    start, stop : int
    out : float32 (H, P)
    """
    rows, pitch = disparity.shape
    size = disparity.size
    lefts, rights, slopes = left.reshape(size), right.reshape(size), slope.reshape(size)
    centres, neighbours = disparity.reshape(size), inside.reshape(size)
    one, zero = np.float32(1.0), np.float32(0.0)
    ones, near = floats_of(one), floats_of(np.float32(SIMILAR))
    sums = np.empty((10, pitch + FLOAT_LANES), np.float32)
    for y in range(start, stop):
        for x in range(radius, radius + columns, FLOAT_LANES):
            at = y * pitch + x
            d0, l0, r0 = load(centres, at), load(lefts, at), load(rights, at)
            n = floats_of(zero)
            s_a = s_b = s_c = s_aa = s_bb = s_cc = s_ab = s_ac = s_bc = n
            for yy in range(max(y - tall, 0), min(y + tall, rows - 1) + 1):
                for dx in range(-radius, radius + 1):
                    to = yy * pitch + x + dx
                    apart = subtract(load(neighbours, to), d0)
                    # from the centre, so that sums of squares stay exact
                    a = where_within(apart, near, subtract(load(lefts, to), l0))
                    b = where_within(apart, near, subtract(load(rights, to), r0))
                    c = where_within(apart, near, load(slopes, to))
                    n = add(n, where_within(apart, near, ones))
                    s_a, s_b, s_c = add(s_a, a), add(s_b, b), add(s_c, c)
                    s_aa, s_bb, s_cc = add(s_aa, multiply(a, a)), add(s_bb, multiply(b, b)), add(s_cc, multiply(c, c))
                    s_ab, s_ac, s_bc = add(s_ab, multiply(a, b)), add(s_ac, multiply(a, c)), add(s_bc, multiply(b, c))
            store(sums[0], x, n)
            store(sums[1], x, s_a)
            store(sums[2], x, s_b)
            store(sums[3], x, s_c)
            store(sums[4], x, s_aa)
            store(sums[5], x, s_bb)
            store(sums[6], x, s_cc)
            store(sums[7], x, s_ab)
            store(sums[8], x, s_ac)
            store(sums[9], x, s_bc)
        for x in range(radius, radius + columns):
            number = max(sums[0, x], one)  # nothing counts around a match outside the image
            aa = sums[4, x] - sums[1, x] * sums[1, x] / number
            bb = sums[5, x] - sums[2, x] * sums[2, x] / number
            cc = sums[6, x] - sums[3, x] * sums[3, x] / number
            ab = sums[7, x] - sums[1, x] * sums[2, x] / number
            ac = sums[8, x] - sums[1, x] * sums[3, x] / number
            bc = sums[9, x] - sums[2, x] * sums[3, x] / number
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
            variance = np.float32(NOISE_VARIANCE) + np.float32(misfit_weight) * max(misfit, zero) / number
            step = pull / (hold + variance / np.float32(PRIOR_SIGMA * PRIOR_SIGMA))
            out[y, x] = disparity[y, x] + min(max(step, np.float32(-STEP_LIMIT)), np.float32(STEP_LIMIT))
