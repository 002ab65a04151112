"""Replace single pixels and lines that the sensor got wrong."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.types import Image, Mask, Views, dn_scale

LINE_SHARE = 0.7  # of a line's pixels must stand out to one side before the line counts as stuck


class RepairStuckPixelsParams(OperatorParams):
    """Parameters of `repair_stuck_pixels`."""

    threshold_dn: float = Field(
        40.0, ge=5.0, le=255.0, description="Least distance of a stuck pixel from all its neighbours, dn"
    )
    line_dn: float = Field(
        8.0, ge=1.0, le=255.0, description="Least distance of the pixels of a stuck row or column from both sides, dn"
    )
    lines: bool = Field(True, description="Also repair whole rows and columns")


def repair_stuck_pixels(views: Views, params: RepairStuckPixelsParams) -> Views:
    """Replace hot and dead pixels by the median of their neighbours, and stuck lines by the mean of the lines beside.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; channels are repaired by themselves.
    params : RepairStuckPixelsParams

    Returns
    -------
    Views
        Images of the same shape and dtype; only repaired pixels change. A pixel is stuck when it is brighter than all
        eight neighbours, or darker than all, by at least the threshold; a line when 70 % of its pixels lie on one side
        of both neighbouring lines by at least `line_dn`. Pairs of touching stuck pixels are not found.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    Glints and stars of one pixel look the same. Run it before anything that spreads a pixel over its neighbours.
    """
    check_pair(views, "correction.repair_stuck_pixels")
    return views.with_images(_repair(views.left, params), _repair(views.right, params))


def _repair(image: Image, params: RepairStuckPixelsParams) -> Image:
    out = image.copy()
    planes = out[..., None] if out.ndim == 2 else out
    scale = dn_scale(image)
    for channel in range(planes.shape[2]):
        plane = cast(Image, np.ascontiguousarray(planes[..., channel]))
        if params.lines:
            _repair_columns(plane, params.line_dn * scale)
            _repair_columns(plane.T, params.line_dn * scale)
        stuck = _stuck(plane, params.threshold_dn * scale)
        if stuck.any():
            plane[stuck] = cv2.medianBlur(plane, 3)[stuck]
        planes[..., channel] = plane
    return out


def _stuck(plane: Image, threshold: float) -> Mask:
    ring = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
    brightest, darkest = cv2.dilate(plane, ring), cv2.erode(plane, ring)
    least = np.int32(np.ceil(threshold))
    hot = cv2.subtract(plane, brightest) >= least  # saturating: 0 where the neighbours are brighter
    dead = cv2.subtract(darkest, plane) >= least
    return np.asarray(hot | dead)


def _repair_columns(plane: NDArray[np.generic], threshold: float) -> None:
    """Replace stuck columns of a plane (H, W) in place."""
    if plane.shape[1] < 3:
        return
    values = plane[::2].astype(np.float32)  # every second row suffices to find a line
    inner, before, after = values[:, 1:-1], values[:, :-2], values[:, 2:]
    above = np.mean(inner - np.maximum(before, after) >= threshold, axis=0)
    below = np.mean(np.minimum(before, after) - inner >= threshold, axis=0)
    for column in np.flatnonzero(np.maximum(above, below) >= LINE_SHARE) + 1:
        beside = plane[:, [column - 1, column + 1]].astype(np.float32).mean(axis=1)
        plane[:, column] = np.rint(beside).astype(plane.dtype)


OPERATOR = Operator(
    name="correction.repair_stuck_pixels",
    slot="defects",
    params=RepairStuckPixelsParams,
    function=repair_stuck_pixels,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=25),
    summary="Replaces hot and dead pixels and stuck lines from their neighbours.",
    suits="Defective sensors; on sound images it costs glints of one pixel.",
)
