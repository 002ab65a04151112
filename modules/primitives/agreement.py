"""What speaks for each disparity of a map: how well the two images agree there, and how well its neighbours do."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.photometry import to_8_bit, to_gray
from modules.types import Disparity, FloatImage, Image, Invalid, Mask

Codes = NDArray[np.uint8]

WINDOW_PX = 9  # side of the window in which intensities are compared
NEIGHBOURHOOD_PX = 15  # side of the window in which valid neighbours are counted
SURFACE_PX = 5  # side of the window in which neighbouring disparities are compared
NOISE_VARIANCE = 1.0  # of gray levels after rounding and a good sensor's noise, DN^2
LEAST_SLOPE = 0.05  # square of the horizontal gradient below which nothing is localised, (DN/px)^2
IMPOSSIBLE = Invalid.MASKED | Invalid.SKY | Invalid.OUTSIDE  # reasons that say nothing about the match
UNKNOWN = 255  # code of evidence that is missing
LAST_CODE = 254

# Kinds of evidence, with the values of the first and the last code.
SCALES = MappingProxyType(
    {
        "correlation": (-0.27, 1.0),
        "misfit": (-6.0, 2.0),  # log2
        "localisation": (-7.0, 3.0),  # log2 of px
        "texture": (-2.0, 6.0),  # log2 of DN/px
        "left_right": (0.0, 2.54),  # px
        "excess": (0.0, 1.27),
        "roughness": (0.0, 2.54),  # px
        "support": (0.0, 1.0),
    }
)


@dataclass(frozen=True)
class Evidence:
    """Evidence for each pixel.

    Attributes
    ----------
    codes : dict from kind to uint8 (H, W)
        0 to 254 over the values of `SCALES`, 255 where unknown. `correlation` of the windows around the pixel and its
        match; `misfit`, the mean square difference of the nearest pixels after both windows are brought to one mean and
        contrast; `localisation`, the standard deviation in px by which noise of the size of their difference shifts a
        match on this texture; `texture`, the root mean square of the horizontal gradient; `left_right`, the difference
        from the disparity of the match; `excess` of the second best cost; `roughness`, the distance from the mean of
        the neighbouring disparities; `support`, the share of valid pixels around.
    valid : bool (H, W)
        Pixels with a disparity whose match lies in the right image. Codes mean something only there.
    density : float
        Valid pixels over those that could be: neither masked nor sky nor matched outside the right image.
    """

    codes: dict[str, Codes]
    valid: Mask
    density: float


def gather_evidence(left: Image, right: Image, disparity: Disparity) -> Evidence:
    """Gather the evidence for each disparity of a map.

    Parameters
    ----------
    left, right : (H, W) or (H, W, 3), uint8 or uint16
        The images that were matched.
    disparity : Disparity

    References
    ----------
    X. Hu and P. Mordohai, A quantitative evaluation of confidence measures for stereo vision, IEEE TPAMI 34(11), 2012.
    """
    one, other = (
        np.asarray(cv2.GaussianBlur(to_8_bit(to_gray(image)), (3, 3), 0), np.uint8) for image in (left, right)
    )
    rows, columns = one.shape
    values = disparity.disparity_px
    column = np.arange(columns, dtype=np.float32) - values
    with np.errstate(invalid="ignore"):
        valid = (column >= -0.5) & (column <= columns - 0.5)
    column[~valid] = -1.0
    row = np.repeat(np.arange(rows, dtype=np.float32)[:, None], columns, axis=1)
    weight = valid.astype(np.uint8)
    warped = np.asarray(cv2.remap(other, column, row, cv2.INTER_LINEAR), np.uint8)
    codes = _photometric(one, warped, weight)
    codes |= _geometric(values, valid, weight)
    codes["left_right"] = _left_right(disparity, column, row, valid)
    codes["excess"] = (
        np.full(values.shape, UNKNOWN, np.uint8) if disparity.excess is None else _code(disparity.excess, "excess")
    )
    possible = int(np.count_nonzero(valid | ((disparity.validity & np.uint16(IMPOSSIBLE)) == 0)))
    return Evidence(codes, valid, int(np.count_nonzero(valid)) / max(possible, 1))


def _photometric(one: Codes, other: Codes, weight: Codes) -> dict[str, Codes]:
    """Compare the left image with the right one sampled at its matches, in windows of valid pixels."""
    one, other = one * weight, other * weight
    count = np.maximum(_box(weight), np.float32(1.0))
    share = np.float32(1.0) / count
    mean_one, mean_other = _box(one) * share, _box(other) * share
    spread_one = np.maximum(_box_of_squares(one) * share - mean_one * mean_one, 0.0)
    spread_other = np.maximum(_box_of_squares(other) * share - mean_other * mean_other, 0.0)
    product = cv2.multiply(one, other, dtype=cv2.CV_32F)
    covariance = _box(product) * share - mean_one * mean_other
    noise = np.float32(NOISE_VARIANCE)
    correlation = covariance / np.sqrt((spread_one + noise) * (spread_other + noise))
    centred = (one - mean_one) / np.sqrt(spread_one + noise) - (other - mean_other) / np.sqrt(spread_other + noise)
    misfit = cv2.boxFilter(centred * centred, cv2.CV_32F, (3, 3), borderType=cv2.BORDER_REFLECT_101)
    slope = cv2.Sobel(one, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    energy = _box(slope * slope) * share
    difference = np.maximum(1.0 - np.maximum(correlation, 0.0), 0.0) * (spread_one + noise) + 0.1 * noise
    shift = np.float32(0.5) * np.log2(difference * share / (energy + np.float32(LEAST_SLOPE)))
    return {
        "correlation": _code(correlation, "correlation"),
        "misfit": _code(np.log2(misfit + np.float32(2.0**-7)), "misfit"),
        "localisation": _code(shift, "localisation"),
        "texture": _code(np.float32(0.5) * np.log2(energy + np.float32(LEAST_SLOPE)), "texture"),
    }


def _geometric(values: FloatImage, valid: Mask, weight: Codes) -> dict[str, Codes]:
    """Compare each disparity with its neighbours."""
    known = np.where(valid, values, np.float32(0.0))
    count = np.maximum(_box(weight, SURFACE_PX), np.float32(1.0))
    roughness = np.abs(_box(known, SURFACE_PX) / count - known)
    support = cv2.boxFilter(weight, cv2.CV_32F, (NEIGHBOURHOOD_PX, NEIGHBOURHOOD_PX), borderType=cv2.BORDER_REFLECT_101)
    return {"roughness": _code(roughness, "roughness"), "support": _code(support, "support")}


def _left_right(disparity: Disparity, column: FloatImage, row: FloatImage, valid: Mask) -> Codes:
    """Compare each disparity with that of its match."""
    if disparity.right_px is None:
        return np.full(valid.shape, UNKNOWN, np.uint8)
    back = cv2.remap(disparity.right_px, column, row, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    return _code(np.abs(back - disparity.disparity_px), "left_right")


def _code(values: NDArray[Any], kind: str) -> Codes:
    """Return values as codes of their kind."""
    low, high = SCALES[kind]
    factor = LAST_CODE / (high - low)
    with np.errstate(invalid="ignore"):
        scaled = np.clip((values - np.float32(low)) * np.float32(factor) + np.float32(0.5), 0, LAST_CODE)
        codes = scaled.astype(np.uint8)
    codes[np.isnan(values)] = UNKNOWN
    return codes


def _box(image: NDArray[Any], side: int = WINDOW_PX) -> FloatImage:
    total = cv2.boxFilter(image, cv2.CV_32F, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(total, np.float32)


def _box_of_squares(image: Codes) -> FloatImage:
    size = (WINDOW_PX, WINDOW_PX)
    return np.asarray(
        cv2.sqrBoxFilter(image, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_CONSTANT), np.float32
    )
