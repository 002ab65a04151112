"""Replace every pixel by its rank among its neighbours."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import to_8_bit, to_levels
from modules.types import Image, Views, full_scale


class RankLocallyParams(OperatorParams):
    """Parameters of `rank_locally`."""

    radius_px: int = Field(4, ge=1, le=7, description="Pixels from the centre of the window to its side, px")


def rank_locally(views: Views, params: RankLocallyParams) -> Views:
    """Replace every pixel of both images by the share of its neighbours that are darker.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB; channels are ranked by themselves, at 8 bit.
    params : RankLocallyParams

    Returns
    -------
    Views
        Images of the same shape and dtype: 0 where no neighbour is darker, full scale where all are; ties count half.
        Rounded to nearest; borders are reflected. A constant image becomes half of full scale.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    Invariant to every increasing map within the window, so even hard shadow edges harm only where they pass. Throws
    contrast away: noise in smooth regions looks like texture.

    References
    ----------
    R. Zabih and J. Woodfill, Non-parametric local transforms for computing visual correspondence, ECCV 1994.
    """
    check_pair(views, "correction.rank_locally")
    return views.with_images(_rank(views.left, params.radius_px), _rank(views.right, params.radius_px))


def _rank(image: Image, radius: int) -> Image:
    levels = to_8_bit(image)
    height, width = levels.shape[:2]
    side = 2 * radius + 1
    padded = cv2.copyMakeBorder(levels, radius, radius, radius, radius, cv2.BORDER_REFLECT_101)
    # At most 225 neighbours, so bytes can count them; a mask of OpenCV is 255, which subtracted adds one.
    darker, not_brighter = np.zeros(levels.shape, np.uint8), np.zeros(levels.shape, np.uint8)
    for index in range(side * side):
        dy, dx = divmod(index, side)
        other = padded[dy : dy + height, dx : dx + width]
        darker -= np.asarray(cv2.compare(other, levels, cv2.CMP_LT), np.uint8)
        not_brighter -= np.asarray(cv2.compare(other, levels, cv2.CMP_LE), np.uint8)
    twice = darker.astype(np.float32)  # the rank, ties half, doubled
    twice += not_brighter
    twice -= 1  # the pixel itself
    return to_levels(twice, full_scale(image) / (2 * (side * side - 1)), 0.0, image)


OPERATOR = Operator(
    name="correction.rank_locally",
    slot="local",
    params=RankLocallyParams,
    function=rank_locally,
    cost=Cost(fixed_ms=0.5, ns_per_pixel=75),
    summary="Replaces every pixel of both images by its rank among its neighbours.",
    suits="Hard shadows and local light with intensity-based costs; harms noisy pairs, useless for census.",
)
