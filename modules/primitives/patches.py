"""Square patches about every cell of a height grid with unknown cells: planes and relief."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.types import Mask

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PatchPlanes:
    """The plane `z = a x + b y + c` through the patch about each cell.

    Attributes
    ----------
    a, b : float64 (H, W)
        Rise per m along columns (x) and rows (y).
    height_m : float64 (H, W)
        Height of the plane at the cell.
    residual_m : float64 (H, W)
        Root mean square distance of the known cells from it, in z.
    enough : bool (H, W)
        Whether the cell is known and enough of its patch is; elsewhere the values mean nothing.
    """

    a: Floats
    b: Floats
    height_m: Floats
    residual_m: Floats
    enough: Mask


def fit_planes(z: Floats, radius: int, cell_m: float, min_fraction: float, used: Mask | None = None) -> PatchPlanes:
    """Fit a plane by least squares to the square patch of `2 radius + 1` cells about every cell.

    Parameters
    ----------
    z : float64 (H, W)
        Heights, m; NaN where unknown.
    radius : int
    cell_m : float
    min_fraction : float
        Smallest known fraction of a patch.
    used : bool (H, W), optional
        Cells that take part; all known ones when None. The plane is given at every cell with enough of them.
    """
    known = np.isfinite(z) if used is None else used & np.isfinite(z)
    offset = np.arange(-radius, radius + 1, dtype=np.float64) * cell_m
    one = np.ones(len(offset))
    level = float(np.mean(z[known])) if known.any() else 0.0  # near zero the sums of squares keep their digits
    filled = np.where(known, z - level, 0.0)
    mask = known.astype(np.float64)

    def total(image: Floats, along_x: NDArray[np.floating], along_y: NDArray[np.floating]) -> Floats:
        return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, along_x, along_y, borderType=cv2.BORDER_CONSTANT))

    n = np.maximum(total(mask, one, one), 1.0)
    mx, my, mz = total(mask, offset, one) / n, total(mask, one, offset) / n, total(filled, one, one) / n
    xx, yy = total(mask, offset**2, one) / n - mx * mx, total(mask, one, offset**2) / n - my * my
    xy = total(mask, offset, offset) / n - mx * my
    xz, yz = total(filled, offset, one) / n - mx * mz, total(filled, one, offset) / n - my * mz
    zz = total(filled * filled, one, one) / n - mz * mz
    determinant = xx * yy - xy * xy
    complete = n >= max(3.0, min_fraction * len(offset) ** 2)
    enough = complete & (determinant > 1e-6 * cell_m**4) & (np.isfinite(z) if used is not None else known)
    safe = np.where(enough, determinant, 1.0)
    a, b = (xz * yy - yz * xy) / safe, (yz * xx - xz * xy) / safe
    residual = np.sqrt(np.maximum(zz - a * xz - b * yz, 0.0))
    return PatchPlanes(a, b, level + mz - a * mx - b * my, residual, enough)


def lowest(z: Floats, kernel: NDArray[np.uint8]) -> Floats:
    """Return the lowest known height (H, W) under the kernel; inf where none is known."""
    filled = np.where(np.isfinite(z), z, np.inf)
    return np.asarray(cv2.erode(filled, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=np.inf))


def highest(z: Floats, kernel: NDArray[np.uint8]) -> Floats:
    """Return the highest known height (H, W) under the kernel; -inf where none is known."""
    filled = np.where(np.isfinite(z), z, -np.inf)
    return np.asarray(cv2.dilate(filled, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=-np.inf))


def relief(z: Floats, radius: int) -> Floats:
    """Return the highest less the lowest known height (H, W) of the square patch of `2 radius + 1` cells."""
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return highest(z, kernel) - lowest(z, kernel)


def disc(radius_cells: float) -> NDArray[np.uint8]:
    """Return a kernel that covers the cells whose centre is within the radius."""
    reach = int(radius_cells)
    i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return (i * i + j * j <= radius_cells * radius_cells + 1e-9).astype(np.uint8)
