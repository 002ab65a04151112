"""Make a filled disparity map beside the measured one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.matching.common import require_disparity
from modules.operator import Cost, Operator, OperatorParams
from modules.types import Disparity, FloatImage, Invalid, Matching


class FillGapsParams(OperatorParams):
    """Parameters of `fill_gaps`."""

    max_gap_px: int = Field(64, ge=1, le=4096, description="Widest gap along a row that is filled, px")


def nearest_along_rows(values: FloatImage) -> tuple[FloatImage, FloatImage, NDArray[np.int64]]:
    """Return the nearest finite value to the left and right of each pixel, NaN without, and the width of its gap."""
    rows, columns = values.shape
    known = np.isfinite(values)
    column = np.arange(columns)
    before = np.maximum.accumulate(np.where(known, column, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, column, columns)[:, ::-1], axis=1)[:, ::-1]
    row = np.arange(rows)[:, None]
    left = np.where(before >= 0, values[row, np.maximum(before, 0)], np.nan)
    right = np.where(after < columns, values[row, np.minimum(after, columns - 1)], np.nan)
    return left.astype(np.float32), right.astype(np.float32), (after - before - 1).astype(np.int64)


def fill_gaps(state: Matching, params: FillGapsParams) -> Matching:
    """Fill gaps along the rows with the farther of the two surfaces beside them, into a product of its own.

    Parameters
    ----------
    state : Matching
        With a disparity, which stays as it is.
    params : FillGapsParams

    Returns
    -------
    Matching
        With `filled`: the disparity in which narrow gaps have a value. Filled pixels carry `Invalid.FILLED` beside the
        reason why they were empty, confidence 0 and no `sigma_px`; masked pixels and sky stay empty.

    Raises
    ------
    OperatorError
        If no matcher has run.

    Notes
    -----
    Filled gaps are wrong by more than 2 px in a quarter or more of the cases with every method tried: for display and
    for programs that bear no holes, never for terrain.

    References
    ----------
    H. Hirschmueller, Stereo Processing by Semiglobal Matching and Mutual Information, IEEE TPAMI 30(2), 2008.
    """
    disparity = require_disparity(state, "matching.fill_gaps")
    left, right, width = nearest_along_rows(disparity.disparity_px)
    background = np.fmin(left, right)
    fillable = (disparity.validity & np.uint16(Invalid.MASKED | Invalid.SKY)) == 0
    fill = ~disparity.valid & fillable & np.isfinite(background) & (width <= params.max_gap_px)
    values = np.where(fill, background, disparity.disparity_px).astype(np.float32)
    validity = np.where(fill, disparity.validity | np.uint16(Invalid.FILLED), disparity.validity).astype(np.uint16)
    nowhere, unknown = np.float32(0.0), np.float32(np.nan)
    filled = Disparity(
        values,
        validity,
        None if disparity.confidence is None else np.where(fill, nowhere, disparity.confidence).astype(np.float32),
        None if disparity.sigma_px is None else np.where(fill, unknown, disparity.sigma_px).astype(np.float32),
    )
    return replace(state, filled=filled)


OPERATOR = Operator(
    name="matching.fill_gaps",
    slot="fill",
    params=FillGapsParams,
    function=fill_gaps,
    cost=Cost(fixed_ms=0.5, ns_per_pixel=60.0),
    summary="Make a filled disparity map beside the measured one, every filled pixel flagged.",
    suits="Display, and programs that bear no holes; never terrain.",
)
