"""Set the disparities to search."""

from __future__ import annotations

from dataclasses import replace

from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.types import DisparityRange, Matching

LARGEST_COUNT = 4096  # larger ranges are a mistake of unit, not a search


class UseRangeParams(OperatorParams):
    """Parameters of `use_range`."""

    min_px: int = Field(0, ge=-8192, le=8192, description="Smallest disparity searched, px")
    max_px: int = Field(64, ge=-8192, le=8192, description="Disparity after the largest one searched, px")


def use_range(state: Matching, params: UseRangeParams) -> Matching:
    """Set the range of disparities to search: `min_px <= d < max_px`.

    Raises
    ------
    OperatorError
        If the range is empty, or wider than 4096 px.
    """
    if params.max_px <= params.min_px:
        raise OperatorError(
            f"matching.use_range: max_px {params.max_px} must be larger than min_px {params.min_px}; exchange or widen "
            "them"
        )
    if params.max_px - params.min_px > LARGEST_COUNT:
        raise OperatorError(
            f"matching.use_range: {params.max_px - params.min_px} disparities exceed the limit of {LARGEST_COUNT}; "
            "narrow the range or reduce the images"
        )
    return replace(state, range_px=DisparityRange(params.min_px, params.max_px))


OPERATOR = Operator(
    name="matching.use_range",
    slot="range",
    params=UseRangeParams,
    function=use_range,
    cost=Cost(fixed_ms=0.01),
    summary="Set the first disparity to search and the one after the last.",
    suits="A range too narrow is ruinous; one up to four times too wide costs only time.",
)
