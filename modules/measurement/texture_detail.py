"""Of what kind the texture of the left image is."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Gray, Sample
from modules.probe import FactModel, Probe, quantity

BLOCK_PX = 16  # of the image at half size
LEVELS = 64  # of 4 dn; finer levels would count noise
BLIND_SHARE = 0.1  # of the gradient energy of a block; less of it along the rows tells a matcher nothing
LEAST_ENERGY_DN2 = 4.0  # mean square of the gradient; blocks with less are noise


class TextureDetail(FactModel):
    """Local entropy and direction of the texture of the left image, at half size; absent: nothing textured."""

    template: ClassVar[str] = "texture_detail"

    local_entropy_bits: float = quantity(
        "Median over blocks of 16x16 px of the entropy of 64 levels", unit="bit", ge=0, le=6, resolution=0.001
    )
    low_entropy_fraction: float = quantity("Blocks whose levels have less than 1 bit", ge=0, le=1, resolution=0.001)
    anisotropy: float | None = quantity(
        "Coherence of the gradients of all textured blocks: 0 for no direction, 1 for stripes",
        ge=0,
        le=1,
        resolution=0.001,
        default=None,
    )
    direction_deg: float | None = quantity(
        "Direction that edges run along, clockwise from the row, where the anisotropy is above 0.1",
        unit="deg",
        ge=-90,
        le=90,
        resolution=1.0,
        default=None,
    )
    row_blind_fraction: float | None = quantity(
        "Textured blocks with less than a tenth of their gradient energy along the rows: edges that cannot be located",
        ge=0,
        le=1,
        resolution=0.001,
        default=None,
    )


def measure_texture_detail(sample: Sample) -> list[TextureDetail]:
    """Return the one `texture_detail` fact of the pair.

    References
    ----------
    J. Bigun and G. H. Granlund, Optimal orientation detection of linear symmetry, ICCV 1987 (coherence); G. A. Miller,
    Note on the bias of information estimates, 1955 (entropy of few samples).
    """
    gray = sample.half[0]
    entropy = _block_entropy(gray)
    across, down, mixed = _block_tensors(gray)
    textured = across + down > LEAST_ENERGY_DN2
    detail = TextureDetail(
        local_entropy_bits=float(np.clip(np.median(entropy), 0, 6)) if entropy.size else 0.0,
        low_entropy_fraction=float(np.mean(entropy < 1)) if entropy.size else 1.0,
    )
    if not textured.any():
        return [detail]
    a, d, m = (float(values[textured].sum()) for values in (across, down, mixed))
    coherence = float(np.hypot(a - d, 2 * m) / (a + d))
    gradient = np.rad2deg(np.arctan2(2 * m, a - d)) / 2  # of the strongest gradient; edges run across it
    told = {
        "anisotropy": min(coherence, 1.0),
        "direction_deg": float((gradient + 180) % 180 - 90) if coherence > 0.1 else None,
        "row_blind_fraction": float(np.mean((across < BLIND_SHARE * (across + down))[textured])),
    }
    return [detail.model_copy(update=told)]


def _block_entropy(gray: Gray) -> NDArray[np.float64]:
    """Return the entropy of the levels of each block, bits."""
    rows, columns = (size // BLOCK_PX for size in gray.shape)
    if not rows or not columns:
        return np.zeros(0)
    blocks = gray[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, columns, BLOCK_PX)
    levels = (blocks.transpose(0, 2, 1, 3) // (256 // LEVELS)).reshape(rows * columns, -1).astype(np.int32)
    levels += LEVELS * np.arange(rows * columns, dtype=np.int32)[:, None]
    counts = np.bincount(levels.ravel(), minlength=rows * columns * LEVELS).reshape(-1, LEVELS)
    weighted = counts * np.log2(np.maximum(counts, 1))
    count = BLOCK_PX * BLOCK_PX
    bias = (np.count_nonzero(counts, axis=1) - 1) / (2 * count * np.log(2))
    return np.asarray(np.log2(count) - weighted.sum(axis=1) / count + bias)


def _block_tensors(gray: Gray) -> tuple[NDArray[np.float32], ...]:
    """Return the mean squares of the gradient along rows and columns of each block, and their mean product, dn^2."""
    size = (gray.shape[1] // BLOCK_PX, gray.shape[0] // BLOCK_PX)
    if min(size) < 1:
        none = np.zeros(0, np.float32)
        return none, none, none
    whole = gray[: size[1] * BLOCK_PX, : size[0] * BLOCK_PX]
    across, down = (
        np.asarray(cv2.Sobel(whole, cv2.CV_32F, *order, ksize=3, scale=1 / 8), np.float32) for order in ((1, 0), (0, 1))
    )
    return tuple(
        np.asarray(cv2.resize(product, size, interpolation=cv2.INTER_AREA), np.float32)
        for product in (across * across, down * down, across * down)
    )


PROBE = Probe(
    "measurement.texture_detail",
    (TextureDetail,),
    measure_texture_detail,
    "medium",
    "pair",
    "Measures local entropy and the direction of the texture.",
)
