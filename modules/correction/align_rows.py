"""Bring corresponding points to the same row."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.rows import RowModel
from modules.primitives.warp import row_alignment_map, warp
from modules.types import Correspondences, Views


class AlignRowsParams(OperatorParams):
    """Parameters of `align_rows`; the values of the fact `row_alignment` with the same meaning."""

    offset_px: float = Field(
        0.0, ge=-200, le=200, description="Rows by which the right image lies below the left one at its centre, px"
    )
    roll_deg: float = Field(0.0, ge=-10, le=10, description="Clockwise rotation of the right image's content, deg")
    row_scale: float = Field(0.0, ge=-0.2, le=0.2, description="Row misalignment per row from the centre, px/px")


def align_rows(views: Views, params: AlignRowsParams) -> Views:
    """Warp the right image so that corresponding points lie in one row.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : AlignRowsParams

    Returns
    -------
    Views
        The left image unchanged; the right image resampled (bicubic, rounded); `right_mask` False where it reads beyond
        the original. Correspondences move along.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    A roll moves columns too, by `-roll (y - cy)`: the whole rotation is undone, so disparities stay right. With all
    parameters zero the views are returned unchanged, without resampling.

    References
    ----------
    D. V. Papadimitriou and T. J. Dennis, Epipolar line estimation and rectification for stereo image pairs, IEEE
    Transactions on Image Processing 5(4), 1996 (vertical alignment).
    """
    check_pair(views, "correction.align_rows")
    if params.offset_px == 0 and params.roll_deg == 0 and params.row_scale == 0:
        return views
    model = RowModel(params.offset_px, float(np.deg2rad(params.roll_deg)), params.row_scale)
    x_px, y_px = row_alignment_map(model, views.shape)
    right, inside = warp(views.right, x_px, y_px)
    if views.right_mask is not None:
        kept, _ = warp(views.right_mask.astype(np.uint8) * np.uint8(255), x_px, y_px)
        inside &= kept > 127
    unchanged = views.unchanged and (views.unchanged[0], warp(views.unchanged[1], x_px, y_px)[0])
    return Views(views.left, right, views.left_mask, inside, _move(views, model), unchanged)


def _move(views: Views, model: RowModel) -> Correspondences | None:
    if views.correspondences is None:
        return None
    cx, cy = (views.shape[1] - 1) / 2, (views.shape[0] - 1) / 2
    x = views.correspondences.right_xy[:, 0] - cx
    y = views.correspondences.right_xy[:, 1] - cy
    v = y * (1 - model.scale) - model.offset_px - np.tan(model.roll_rad) * x
    u = (x + np.sin(model.roll_rad) * v) / np.cos(model.roll_rad)
    moved = np.stack([u + cx, v + cy], axis=1).astype(np.float32)
    return Correspondences(views.correspondences.left_xy, moved)


OPERATOR = Operator(
    name="correction.align_rows",
    slot="align",
    params=AlignRowsParams,
    function=align_rows,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=25),
    summary="Warps the right image by a row offset, a roll and a row scale, so that matches lie in one row.",
    suits="Residual vertical misalignment of 0.25 px and more; on aligned pairs it only costs sharpness.",
)
