"""Keep the band of detail that a Laplacian of Gaussian passes."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from modules.correction._shared import check_pair
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.photometry import to_levels
from modules.types import Image, Views, dn_scale


class FilterLaplacianParams(OperatorParams):
    """Parameters of `filter_laplacian`."""

    sigma_px: float = Field(1.5, ge=0.5, le=10.0, description="Standard deviation of the Gaussian, px")
    gain: float = Field(4.0, ge=0.5, le=100.0, description="Output DN per DN of the response, 1")


def filter_laplacian(views: Views, params: FilterLaplacianParams) -> Views:
    """Replace both images by their scale-normalised Laplacian of Gaussian, with one scaling for both.

    Parameters
    ----------
    views : Views
        uint8 or uint16, gray or RGB.
    params : FilterLaplacianParams

    Returns
    -------
    Views
        Images of the same shape and dtype: `full / 2 - gain sigma^2 (Laplacian of Gaussian)`, so that bright blobs are
        bright; rounded to nearest and clipped; borders are reflected. A constant image becomes half of full scale.

    Raises
    ------
    OperatorError
        If the images differ in shape or dtype.

    Notes
    -----
    Removes offsets and slow changes of offset, not gain; noise above the band is damped, within it amplified.

    References
    ----------
    D. Marr and E. Hildreth, Theory of edge detection, Proceedings of the Royal Society B 207, 1980; S. Goldberg,
    M. Maimone, L. Matthies, Stereo vision and rover navigation software for planetary exploration, IEEE Aerospace 2002
    (as a prefilter).
    """
    check_pair(views, "correction.filter_laplacian")
    return views.with_images(_filter(views.left, params), _filter(views.right, params))


def _filter(image: Image, params: FilterLaplacianParams) -> Image:
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), params.sigma_px)
    response = np.asarray(cv2.Laplacian(blurred, cv2.CV_32F, ksize=1), dtype=np.float32)
    gain = -params.gain * params.sigma_px**2
    return to_levels(response, gain, 127.5 * dn_scale(image), image)


OPERATOR = Operator(
    name="correction.filter_laplacian",
    slot="local",
    params=FilterLaplacianParams,
    function=filter_laplacian,
    cost=Cost(fixed_ms=0.5, ns_per_pixel=18),
    summary="Replaces both images by their Laplacian of Gaussian, one scaling for both.",
    suits="Offsets and soft light with weak noise; harms noisy pairs and differences of gain.",
)
