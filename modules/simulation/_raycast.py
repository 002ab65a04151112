"""Compiled kernels of the terrain renderer; imported inside functions only, since numba takes time to import.

A surface is a pair of height grids: a fine `near` grid and a coarse `far` grid around it, bilinear in between, with the
maximum of each block of `BLOCK` x `BLOCK` cells and of `COARSE` x `COARSE` such blocks: a ray jumps over blocks that it
clears.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

BLOCK = 8
COARSE = 8  # blocks per coarse block and axis
MISS = np.inf


@njit(cache=True, nogil=True)
def bilinear(grid: Any, x0: float, y0: float, cell: float, x: float, y: float) -> float:
    """Return a grid's value between its nodes; outside, that of its border."""
    column = (x - x0) / cell
    row = (y - y0) / cell
    j = min(max(int(np.floor(column)), 0), grid.shape[1] - 2)
    i = min(max(int(np.floor(row)), 0), grid.shape[0] - 2)
    b = min(max(column - j, 0.0), 1.0)
    a = min(max(row - i, 0.0), 1.0)
    top = grid[i, j] * (1.0 - b) + grid[i, j + 1] * b
    bottom = grid[i + 1, j] * (1.0 - b) + grid[i + 1, j + 1] * b
    return top * (1.0 - a) + bottom * a


@njit(cache=True, nogil=True)
def inside(grid: Any, x0: float, y0: float, cell: float, x: float, y: float) -> bool:
    """Return whether a point lies on a grid."""
    return x0 <= x < x0 + (grid.shape[1] - 1) * cell and y0 <= y < y0 + (grid.shape[0] - 1) * cell


@njit(cache=True, nogil=True)
def heights(near: Any, near_at: Any, far: Any, far_at: Any, x: Any, y: Any) -> Any:
    """Return the values at points (N,): of the near grid inside it, else of the far grid."""
    out = np.empty(x.shape[0])
    for k in range(x.shape[0]):
        if inside(near, near_at[0], near_at[1], near_at[2], x[k], y[k]):
            out[k] = bilinear(near, near_at[0], near_at[1], near_at[2], x[k], y[k])
        else:
            out[k] = bilinear(far, far_at[0], far_at[1], far_at[2], x[k], y[k])
    return out


@njit(cache=True, nogil=True)
def block_maxima(grid: Any) -> Any:
    """Return the maximum of each block, borders included; and of each coarse block."""
    rows = (grid.shape[0] - 1) // BLOCK
    columns = (grid.shape[1] - 1) // BLOCK
    out = np.empty((rows, columns), np.float32)
    for i in range(rows):
        for j in range(columns):
            out[i, j] = grid[i * BLOCK : (i + 1) * BLOCK + 1, j * BLOCK : (j + 1) * BLOCK + 1].max()
    coarse = np.empty((rows // COARSE, columns // COARSE), np.float32)
    for i in range(rows // COARSE):
        for j in range(columns // COARSE):
            coarse[i, j] = out[i * COARSE : (i + 1) * COARSE, j * COARSE : (j + 1) * COARSE].max()
    return out, coarse


@njit(cache=True, nogil=True)
def block_exit(
    x: float, y: float, t: float, dx: float, dy: float, x0: float, y0: float, size: float, limit: float
) -> Any:
    """Return the distance at which a ray leaves its block, and the row and column of the block."""
    j = int((x - x0) / size)
    i = int((y - y0) / size)
    leave = limit
    if dx > 0.0:
        leave = min(leave, t + (x0 + (j + 1) * size - x) / dx)
    elif dx < 0.0:
        leave = min(leave, t + (x0 + j * size - x) / dx)
    if dy > 0.0:
        leave = min(leave, t + (y0 + (i + 1) * size - y) / dy)
    elif dy < 0.0:
        leave = min(leave, t + (y0 + i * size - y) / dy)
    return leave + 1e-7, i, j  # past the border, so that the next block is another one


@njit(cache=True, nogil=True)
def first_hit(
    origin: Any,
    dx: float,
    dy: float,
    dz: float,
    near: Any,
    near_at: Any,
    near_max: Any,
    near_coarse: Any,
    far: Any,
    far_at: Any,
    far_max: Any,
    far_coarse: Any,
    top: float,
    start: float,
    limit: float,
) -> float:
    """Return the distance to the first crossing from above, or MISS; the direction has unit length."""
    t = start
    if origin[2] + t * dz > top:
        if dz >= 0.0:
            return MISS
        t = (top - origin[2]) / dz
    while t < limit:
        x = origin[0] + t * dx
        y = origin[1] + t * dy
        z = origin[2] + t * dz
        if dz >= 0.0 and z > top:
            return MISS
        use_near = inside(near, near_at[0], near_at[1], near_at[2], x, y)
        if use_near:
            x0, y0, cell = near_at[0], near_at[1], near_at[2]
        else:
            if not inside(far, far_at[0], far_at[1], far_at[2], x, y):
                return MISS
            x0, y0, cell = far_at[0], far_at[1], far_at[2]
        maxima = near_max if use_near else far_max
        coarse = near_coarse if use_near else far_coarse
        leave, i, j = block_exit(x, y, t, dx, dy, x0, y0, cell * BLOCK * COARSE, limit)
        if min(z, origin[2] + leave * dz) > coarse[min(i, coarse.shape[0] - 1), min(j, coarse.shape[1] - 1)]:
            t = leave
            continue
        leave, i, j = block_exit(x, y, t, dx, dy, x0, y0, cell * BLOCK, limit)
        if min(z, origin[2] + leave * dz) > maxima[min(i, maxima.shape[0] - 1), min(j, maxima.shape[1] - 1)]:
            t = leave
            continue
        step = 0.6 * cell
        before = t
        while before < leave:
            after = min(before + step, leave)
            x = origin[0] + after * dx
            y = origin[1] + after * dy
            if use_near:
                ground = bilinear(near, x0, y0, cell, x, y)
            else:
                ground = bilinear(far, x0, y0, cell, x, y)
            if origin[2] + after * dz <= ground:
                low, high = before, after
                for _ in range(16):
                    middle = 0.5 * (low + high)
                    x = origin[0] + middle * dx
                    y = origin[1] + middle * dy
                    if use_near:
                        ground = bilinear(near, x0, y0, cell, x, y)
                    else:
                        ground = bilinear(far, x0, y0, cell, x, y)
                    if origin[2] + middle * dz <= ground:
                        high = middle
                    else:
                        low = middle
                return 0.5 * (low + high)
            before = after
        t = leave
    return MISS


@njit(cache=True, nogil=True)
def cast(
    origin: Any,
    directions: Any,
    starts: Any,
    near: Any,
    near_at: Any,
    near_max: Any,
    near_coarse: Any,
    far: Any,
    far_at: Any,
    far_max: Any,
    far_coarse: Any,
    top: float,
    limit: float,
) -> Any:
    """Return the distance along each unit direction (N, 3) to the surface."""
    out = np.empty(directions.shape[0])
    for k in range(directions.shape[0]):
        dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
        out[k] = first_hit(
            origin,
            dx,
            dy,
            dz,
            near,
            near_at,
            near_max,
            near_coarse,
            far,
            far_at,
            far_max,
            far_coarse,
            top,
            starts[k],
            limit,
        )
    return out


@njit(cache=True, nogil=True)
def sunlit(grid: Any, maxima: Any, cell: float, sx: float, sy: float, rise: float) -> Any:
    """Return 1 where the sun is seen from a node, else 0; (sx, sy) points to the sun, `rise` is tan(elevation)."""
    out = np.ones(grid.shape, np.float32)
    top = maxima.max()
    rows, columns = grid.shape
    for i in range(rows):
        for j in range(columns):
            step = 1.5
            z = grid[i, j] + step * cell * rise
            while z < top:
                x = j + sx * step
                y = i + sy * step
                if x < 0.0 or y < 0.0 or x >= columns - 1 or y >= rows - 1:
                    break
                bi, bj = int(y) // BLOCK, int(x) // BLOCK
                stride = 1.0
                if z >= maxima[bi, bj]:  # whole steps inside this block cannot hit either
                    free = 2.0 * BLOCK
                    if sx != 0.0:
                        free = min(free, ((bj + (sx > 0.0)) * BLOCK - x) / sx)
                    if sy != 0.0:
                        free = min(free, ((bi + (sy > 0.0)) * BLOCK - y) / sy)
                    stride = max(1.0, np.ceil(free))
                elif z < bilinear(grid, 0.0, 0.0, 1.0, x, y):
                    out[i, j] = 0.0
                    break
                step += stride
                z += stride * cell * rise
    return out


@njit(cache=True, nogil=True)
def texture(tile: Any, points: Any, footprint: Any, wavelengths: Any, offsets: Any, per_wave: float) -> Any:
    """Sum octaves of a periodic noise tile at (N, 3) points; an octave fades where a pixel covers its wavelength."""
    out = np.zeros(points.shape[0], np.float32)
    size = tile.shape[0]
    for k in range(points.shape[0]):
        # Heights enter, so that steep faces have texture along the vertical as well.
        x = points[k, 0] + 0.83 * points[k, 2]
        y = points[k, 1] + 0.71 * points[k, 2]
        total = 0.0
        for n in range(wavelengths.shape[0]):
            ratio = footprint[k] / wavelengths[n]
            if ratio > 1.0:
                continue
            column = x / wavelengths[n] * per_wave + offsets[n, 0]
            row = y / wavelengths[n] * per_wave + offsets[n, 1]
            fj = np.floor(column)
            fi = np.floor(row)
            b = column - fj
            a = row - fi
            j = int(fj) % size
            i = int(fi) % size
            j1 = (j + 1) % size
            i1 = (i + 1) % size
            value = (tile[i, j] * (1 - b) + tile[i, j1] * b) * (1 - a) + (tile[i1, j] * (1 - b) + tile[i1, j1] * b) * a
            total += value * np.exp(-4.0 * ratio * ratio)
        out[k] = total
    return out
