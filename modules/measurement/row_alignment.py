"""Whether corresponding points lie in one row."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from modules.measurement.sample import Sample
from modules.operator import Cost
from modules.primitives.rows import RowModel, centre
from modules.probe import FactModel, Probe, quantity
from modules.types import Correspondences, DisparityRange

GRID = 4  # the coverage counts cells of a 4 x 4 grid
CELL_MATCHES = 3
MODEL_ERROR_PX = 0.05  # real rectifications are not quite of this shape


class RowAlignment(FactModel):
    """Row misalignment `a + b (x - cx) + c (y - cy)` of the right image; absent fields: no fit."""

    template: ClassVar[str] = "row_alignment"

    count: int = quantity("Matches that agree with the fit", ge=0)
    coverage_fraction: float = quantity(
        "Cells of a 4 x 4 grid with at least 3 agreeing matches", ge=0, le=1, resolution=0.0625
    )
    offset_px: float | None = quantity(
        "Rows by which the right image lies lower at its centre",
        unit="px",
        resolution=0.01,
        sigma="sigma_px",
        default=None,
    )
    roll_deg: float | None = quantity("Roll of the right image", unit="deg", resolution=0.001, default=None)
    scale: float | None = quantity(
        "Misalignment per row from the centre", unit="px/px", resolution=0.00001, default=None
    )
    sigma_px: float | None = quantity("Standard error of the offset", unit="px", ge=0, resolution=0.001, default=None)
    residual_px: float | None = quantity(
        "Robust standard deviation of the row differences from the fit", unit="px", ge=0, resolution=0.01, default=None
    )
    rms_px: float | None = quantity(
        "Root mean square misalignment over the image", unit="px", ge=0, resolution=0.01, default=None
    )
    max_abs_px: float | None = quantity(
        "Largest misalignment over the image", unit="px", ge=0, resolution=0.01, default=None
    )
    inside_fraction: float | None = quantity(
        "Agreeing matches whose disparity lies in the given range; absent where none was given",
        ge=0,
        le=1,
        resolution=0.01,
        default=None,
    )


def coverage(points: Correspondences, shape: tuple[int, int]) -> float:
    """Return the fraction of grid cells of the left image with at least 3 matches."""
    if not len(points):
        return 0.0
    column = np.clip(points.left_xy[:, 0] * GRID / shape[1], 0, GRID - 1).astype(int)
    row = np.clip(points.left_xy[:, 1] * GRID / shape[0], 0, GRID - 1).astype(int)
    counts = np.bincount(row * GRID + column, minlength=GRID * GRID)
    return float(np.mean(counts >= CELL_MATCHES))


def measure_row_alignment(sample: Sample) -> list[RowAlignment]:
    """Return the one `row_alignment` fact of the pair, from sparse matches."""
    features = sample.features
    agreeing = features.agreeing
    if features.fit is None:
        return [RowAlignment(count=0, coverage_fraction=0.0)]
    model = features.fit.model
    offset_px = _at_full_centre(model, sample)
    whole = RowModel(offset_px, model.roll_rad, model.scale)
    return [
        RowAlignment(
            count=len(agreeing),
            coverage_fraction=coverage(agreeing, sample.shape),
            offset_px=offset_px,
            roll_deg=float(np.rad2deg(model.roll_rad)),
            scale=model.scale,
            sigma_px=float(np.hypot(features.fit.sigma_px, MODEL_ERROR_PX)),
            residual_px=features.fit.residual_px,
            rms_px=whole.rms_px(sample.full_shape),
            max_abs_px=whole.max_abs_px(sample.full_shape),
            inside_fraction=_inside(agreeing, sample.given_range),
        )
    ]


def _inside(points: Correspondences, given: DisparityRange | None) -> float | None:
    """Return the share of points whose disparity is searched, to within a pixel."""
    if given is None or not len(points):
        return None
    disparity_px = points.left_xy[:, 0] - points.right_xy[:, 0]
    return float(np.mean((disparity_px >= given.min_px - 1.0) & (disparity_px <= given.max_px)))


def _at_full_centre(model: RowModel, sample: Sample) -> float:
    """Return the offset at the centre of the whole image, of which the sample may have cut padding off."""
    cx, cy = centre(sample.full_shape)
    x, y = np.array([cx - sample.origin[1]]), np.array([cy - sample.origin[0]])
    return float(model.rows_below(x, y, sample.shape)[0])


PROBE = Probe(
    "measurement.row_alignment",
    (RowAlignment,),
    measure_row_alignment,
    "medium",
    "pair",
    "Fits a row offset, a roll and a row scale to sparse matches.",
    cost=Cost(fixed_ms=7, ns_per_pixel=10),
)
