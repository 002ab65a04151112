"""Points that stand off their neighbours more than others do."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.statistics import robust_sigma
from modules.reconstruction.plain import load_kernels
from modules.reconstruction.remove_radius_outliers import disparity_of_points, drop_pixels
from modules.types import Scene


class RemoveStatisticalOutliersParams(OperatorParams):
    """Parameters of `remove_statistical_outliers`."""

    radius_px: int = Field(2, ge=1, le=15, description="Half the edge of the window in which neighbours count, px")
    nearest: int = Field(8, ge=1, le=64, description="Number of nearest neighbours whose distance is averaged")
    max_sigma: float = Field(
        6.0, gt=0.0, le=100.0, description="Largest distance above the median, in robust standard deviations"
    )
    least_px: float = Field(0.3, ge=0.0, le=20.0, description="Distances up to this are never outliers, px")


def remove_statistical_outliers(scene: Scene, params: RemoveStatisticalOutliersParams) -> Scene:
    """Drop points whose mean distance to their nearest neighbours is unusual for this pair.

    Distances are differences of disparity in a window of the image: there noise is the same near and far. Median and
    median absolute deviation replace mean and standard deviation, which the outliers themselves would widen.

    Parameters
    ----------
    scene : Scene
        Needs `points`.
    params : RemoveStatisticalOutliersParams

    Returns
    -------
    Scene
        With fewer points and the count `statistical_outlier` in `rejected`; points with fewer than `nearest`
        neighbours in the window are dropped as well.

    Raises
    ------
    OperatorError
        When there are no points, or none is left.

    References
    ----------
    R. Rusu and S. Cousins, "3D is here: Point Cloud Library (PCL)", IEEE ICRA 2011 (statistical outlier removal).
    """
    kernels = load_kernels()

    distance = kernels.nearest_difference(disparity_of_points(scene), params.radius_px, params.nearest)
    known = distance[np.isfinite(distance)]
    if known.size == 0:
        limit = 0.0
    else:
        limit = max(float(np.median(known)) + params.max_sigma * robust_sigma(known), params.least_px)
    with np.errstate(invalid="ignore"):
        outlier = ~(distance <= limit)
    return drop_pixels(scene, outlier, "statistical_outlier", "raise max_sigma or lower nearest")


OPERATOR = Operator(
    name="reconstruction.remove_statistical_outliers",
    slot="outliers",
    params=RemoveStatisticalOutliersParams,
    function=remove_statistical_outliers,
    cost=Cost(fixed_ms=3.0, ns_per_pixel=120.0),
    summary="Drops points that stand off their nearest neighbours more than is usual for the pair.",
    suits="Scattered wrong matches; on a scene with many depth edges it also takes true points at them.",
)
