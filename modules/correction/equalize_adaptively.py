"""Equalize histograms locally, with limited contrast."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from pydantic import Field

from modules.correction._shared import check_pair, planes_of
from modules.operator import Cost, Operator, OperatorParams
from modules.types import Image, Views


class EqualizeAdaptivelyParams(OperatorParams):
    """Parameters of `equalize_adaptively`."""

    clip_limit: float = Field(2.0, ge=0.5, le=40.0, description="Largest slope over that of the identity, 1")
    tiles: int = Field(8, ge=1, le=64, description="Tiles per side of the image, 1")


def equalize_adaptively(views: Views, params: EqualizeAdaptivelyParams) -> Views:
    """Equalize every channel of both images per tile, with limited contrast (CLAHE).

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : EqualizeAdaptivelyParams

    Returns
    -------
    Views
        Images of the same shape and dtype, as OpenCV rounds them. A constant image stays constant.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    The maps of a tile in one image and of the tile that sees the same things in the other differ wherever contents do.
    Raises weak texture under soft light; harms noisy pairs.

    References
    ----------
    K. Zuiderveld, Contrast limited adaptive histogram equalization, Graphics Gems IV, 1994.
    """
    check_pair(views, "correction.equalize_adaptively")
    return views.with_images(_equalize(views.left, params), _equalize(views.right, params))


def _equalize(image: Image, params: EqualizeAdaptivelyParams) -> Image:
    worker = cv2.createCLAHE(params.clip_limit, (params.tiles, params.tiles))
    done = [worker.apply(plane) for plane in planes_of(image)]
    return cast(Image, np.stack(done, axis=-1).reshape(image.shape))


OPERATOR = Operator(
    name="correction.equalize_adaptively",
    slot="local",
    params=EqualizeAdaptivelyParams,
    function=equalize_adaptively,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=25),
    summary="Equalizes both images per tile with limited contrast.",
    suits="Weak texture under soft light; harms noisy pairs and raises the error of clean ones.",
)
