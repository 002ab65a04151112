"""Points with too few neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.reconstruction.plain import load_kernels
from modules.types import FloatImage, Mask, Scene


class RemoveRadiusOutliersParams(OperatorParams):
    """Parameters of `remove_radius_outliers`."""

    radius_px: int = Field(3, ge=1, le=15, description="Half the edge of the window in which neighbours count, px")
    min_neighbours: int = Field(8, ge=1, le=900, description="Fewest neighbours of a point that is kept")
    gradient: float = Field(0.3, ge=0.0, le=5.0, description="Disparity may change by this much per px on a surface")
    tolerance_px: float = Field(0.5, gt=0.0, le=20.0, description="And by this much by noise, px")


def remove_radius_outliers(scene: Scene, params: RemoveRadiusOutliersParams) -> Scene:
    """Drop points that have too few neighbours on one surface with them.

    Neighbours are looked for in the image, not in space: there the spacing is the same near and far, noise of the
    disparity is too, and no search tree is needed.

    Parameters
    ----------
    scene : Scene
        Needs `points`.
    params : RemoveRadiusOutliersParams

    Returns
    -------
    Scene
        With fewer points and the count `isolated` in `rejected`.

    Raises
    ------
    OperatorError
        When there are no points, or none is left.

    References
    ----------
    R. Rusu and S. Cousins, "3D is here: Point Cloud Library (PCL)", IEEE ICRA 2011 (radius outlier removal).
    """
    kernels = load_kernels()

    disparity = disparity_of_points(scene)
    count = kernels.count_agreeing(disparity, params.radius_px, params.gradient, params.tolerance_px)
    return drop_pixels(scene, count < params.min_neighbours, "isolated", "lower min_neighbours")


def disparity_of_points(scene: Scene) -> FloatImage:
    """Return the disparity (H, W) of the pixels that still are points, NaN elsewhere."""
    points = scene.points
    if points is None or len(points) == 0:
        raise OperatorError("there are no points to clean; triangulate a disparity map with valid pixels first")
    full = scene.disparity.disparity_px
    kept: NDArray[np.float32] = np.full(full.size, np.nan, np.float32)
    kept[points.pixel] = full.ravel()[points.pixel]
    return kept.reshape(full.shape)


def drop_pixels(scene: Scene, outlier: Mask, reason: str, remedy: str) -> Scene:
    """Return the scene without the points on the pixels `outlier` (H, W), counted under `reason`."""
    points = scene.points
    if points is None:
        raise OperatorError("there are no points to clean; triangulate a disparity map with valid pixels first")
    keep = ~outlier.ravel()[points.pixel]
    dropped = len(points) - int(np.count_nonzero(keep))
    if dropped == len(points):
        raise OperatorError(f"all {len(points)} points are outliers ({reason}); {remedy}")
    if dropped == 0:
        return scene
    rejected = {**scene.rejected, reason: scene.rejected.get(reason, 0) + dropped}
    return replace(scene, points=points.select(keep), rejected=rejected)


OPERATOR = Operator(
    name="reconstruction.remove_radius_outliers",
    slot="outliers",
    params=RemoveRadiusOutliersParams,
    function=remove_radius_outliers,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=60.0),
    summary="Drops points that have too few neighbours on one surface with them.",
    suits="Lone wrong matches that a speckle filter left; harms thin structures.",
)
