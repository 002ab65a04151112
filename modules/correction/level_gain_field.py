"""Remove a smooth field of gain between the images, such as vignetting."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from modules.correction._corresponding import Corresponding, corresponding
from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.photometry import to_levels
from modules.primitives.statistics import Floats, fit_linear
from modules.types import FloatImage, Image, Views

FLOOR_DN = 4.0  # added before logarithms; darker blocks say little about gain
BLOCKS = 24  # per side; each averages noise and small errors of the match away
LEAST_BLOCKS = 12
NODES = 33  # per side of the image, between which the field is interpolated


class LevelGainFieldParams(OperatorParams):
    """Parameters of `level_gain_field`."""

    reference: Literal["left", "right"] = Field("left", description="Image that stays as it is")
    shape: Literal["radial", "plane", "quadratic"] = Field(
        "radial", description="radial: even in the distance from the centre, to its 4th power; plane: a gradient"
    )
    gain_limit: float = Field(5.0, ge=1.0, le=20.0, description="Largest gain, and inverse of the smallest, 1")


def level_gain_field(views: Views, params: LevelGainFieldParams) -> Views:
    """Fit a smooth field to the log ratio of corresponding blocks and undo it in one image.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; every channel has a field of its own, masked pixels give none.
    params : LevelGainFieldParams

    Returns
    -------
    Views
        Images of the same shape and dtype, clipped to the range of the dtype and rounded to nearest.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype, or fewer than 12 blocks of 24 x 24 match in their thumbnails.

    Notes
    -----
    Three to six coefficients per channel cannot follow the content, so unlike local transfers it may be trusted where
    the match is poor; it removes nothing but the shape it knows. Vignetting that both cameras share cancels.

    References
    ----------
    D. B. Goldman, Vignette and exposure calibration and compensation, IEEE TPAMI 32(12), 2010 (even polynomials).
    """
    name = "correction.level_gain_field"
    check_pair(views, name)
    seen = corresponding(views, params.reference, name)
    size = (views.shape[1], views.shape[0])
    field = _field(seen, params)
    gain = np.asarray(cv2.resize(field, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)
    if params.reference == "left":
        return views.with_images(views.left, _apply(views.right, gain))
    return views.with_images(_apply(views.left, gain), views.right)


def _terms(x: Floats, y: Floats, aspect: float, shape: str) -> Floats:
    """Return the terms of the field, (N, K), at points whose coordinates run from -1 to 1 over the image."""
    if shape == "plane":
        return np.stack([np.ones_like(x), x, y], axis=-1)
    if shape == "quadratic":
        return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    squared = (x**2 + (aspect * y) ** 2) / (1 + aspect**2)
    return np.stack([np.ones_like(x), squared, squared**2], axis=-1)


def _field(seen: Corresponding, params: LevelGainFieldParams) -> Floats:
    """Return the gain at `NODES` x `NODES` points spread over the image, (NODES, NODES, C)."""
    height, width, channels = seen.source.shape
    side = (min(BLOCKS, width), min(BLOCKS, height))
    use = seen.valid.astype(np.float32)
    share = cv2.resize(use, side, interpolation=cv2.INTER_AREA)
    known = share > 0.3
    if np.count_nonzero(known) < LEAST_BLOCKS:
        raise OperatorError(
            f"correction.level_gain_field: only {np.count_nonzero(known)} of {side[0] * side[1]} blocks match, "
            f"{LEAST_BLOCKS} are needed; use correction.match_histograms"
        )
    y, x = (2 * (np.indices(share.shape) + 0.5) / np.array(share.shape)[:, None, None] - 1).astype(np.float64)
    design = _terms(x[known], y[known], height / width, params.shape)
    nodes = np.linspace(-1, 1, NODES)
    everywhere = _terms(*np.meshgrid(nodes, nodes), height / width, params.shape)
    field = np.empty((NODES, NODES, channels))
    for channel in range(channels):
        blocks = [
            cv2.resize(image[..., channel] * use, side, interpolation=cv2.INTER_AREA)[known] / share[known] + FLOOR_DN
            for image in (seen.source, seen.reference)
        ]
        ratio = np.log(blocks[1].astype(np.float64) / blocks[0])
        coefficients, _, _ = fit_linear(design, ratio, 0.005)
        field[..., channel] = np.exp(everywhere @ coefficients)
    return np.clip(field, 1 / params.gain_limit, params.gain_limit)


def _apply(image: Image, gain: FloatImage) -> Image:
    return to_levels(gain.reshape(image.shape) * image, 1.0, 0.0, image)


OPERATOR = Operator(
    name="correction.level_gain_field",
    slot="local",
    params=LevelGainFieldParams,
    function=level_gain_field,
    cost=Cost(fixed_ms=12.0, ns_per_pixel=38),
    summary="Fits a smooth field of gain between the images and undoes it in one image.",
    suits="Vignetting and lighting gradients of otherwise linear cameras; not shadows, useless for census.",
)
