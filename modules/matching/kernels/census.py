"""Census transforms: which pixels of a window are darker than its centre."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modules.matching.kernels.compiler import kernel


@kernel
def _compare(
    centre: NDArray[np.int16],
    other: NDArray[np.int16],
    margin: np.int16,
    brighter: bool,
    bit: np.uint8,
    out: NDArray[np.uint8],
) -> None:
    """Set a bit where one row differs from another by more than a margin."""
    for x in range(out.shape[0]):
        step = np.int16(other[x] - centre[x]) if brighter else np.int16(centre[x] - other[x])
        out[x] = np.uint8(out[x] | (bit if step > margin else np.uint8(0)))


@kernel
def census(
    image: NDArray[np.int16], offsets: NDArray[np.int64], margin: int, ternary: bool, out: NDArray[np.uint8]
) -> None:
    """Set the bits of comparisons with the centre, one for each offset, or two.

    Parameters
    ----------
    image : int16 (H + 2 r, W + 2 r)
        Continued beyond the border by the largest offset r.
    offsets : int64 (N, 2)
        Rows and columns from the centre.
    margin : int
        A pixel is darker, or brighter, if it differs by more than this, levels.
    ternary : bool
        Two bits: darker and brighter; else only darker.
    out : uint8 (K, H, W)
        Zero; at least N, or 2 N, bits.
    """
    rows, columns = out.shape[1], out.shape[2]
    radius = (image.shape[0] - rows) // 2
    for y in range(rows):
        centre = image[y + radius, radius : radius + columns]
        for k in range(offsets.shape[0]):
            first = radius + offsets[k, 1]
            other = image[y + radius + offsets[k, 0], first : first + columns]
            at = 2 * k if ternary else k
            _compare(centre, other, np.int16(margin), False, np.uint8(1 << (at % 8)), out[at // 8, y])
            if ternary:
                at += 1
                _compare(centre, other, np.int16(margin), True, np.uint8(1 << (at % 8)), out[at // 8, y])
