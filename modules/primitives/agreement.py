"""What speaks for each disparity of a map: how well the two images agree there, and how well its neighbours do."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.chance import agreement_over_chance
from modules.primitives.photometry import to_8_bit, to_gray
from modules.types import Disparity, DisparityRange, FloatImage, Image, Invalid, Mask

Codes = NDArray[np.uint8]

STEP = 2  # intensities are compared on every second row and column: their windows reach over more than that
WINDOW = 5  # side of the window in which intensities are compared, on that grid
NEIGHBOURHOOD_PX = 15  # side of the window in which valid neighbours are counted
SURFACE_PX = 5  # side of the window in which neighbouring disparities are compared
BREAK_PX = 1.0  # neighbouring disparities that differ by more do not belong to one surface
NOISE_VARIANCE = 1.0  # of gray levels after rounding and a good sensor's noise, DN^2
LEAST_SLOPE = 0.05  # square of the horizontal gradient below which nothing is localised, (DN/px)^2
SAMPLE = 4096  # differences that suffice for their percentile, at least
QUARTER = 25  # percentile of the differences over the map that right matches are taken to have
MEDIAN_OF_NORMAL = 0.6745  # median of the absolute value of a standard normal variable
SHIFT_VARIANCE = 0.04  # of right matches, by rounding and subpixel errors, px^2
UNWANTED = Invalid.MASKED | Invalid.SKY  # pixels that are not to be matched
STEP_PX = 3.0  # a larger difference of neighbouring disparities is an edge of an object
FLAT_DN = 0.5  # added to gradients before they are compared
UNKNOWN = 255  # code of evidence that is missing
LAST_CODE = 254

# Kinds of evidence, with the values of the first and the last code.
SCALES = MappingProxyType(
    {
        "correlation": (-0.27, 1.0),
        "misfit": (-6.0, 2.0),  # log2
        "surprise": (-2.0, 6.0),  # log2
        "localisation": (-7.0, 3.0),  # log2 of px
        "left_right": (0.0, 2.54),  # px
        "excess": (0.0, 1.27),
        "roughness": (0.0, 2.54),  # px
        "breaks": (0.0, 1.0),
        "support": (0.0, 1.0),
    }
)


@dataclass(frozen=True)
class Evidence:
    """Evidence for each pixel.

    Attributes
    ----------
    coarse : dict from kind to uint8 (ceil(H / 2), ceil(W / 2))
        Codes of what the images say around every second pixel: 0 to 254 over the values of `SCALES`. `correlation` of
        the windows around the pixel and its match; `misfit`, the mean square difference of the nearest pixels after
        both windows are brought to one mean and contrast; `surprise`, the difference of the windows over that of the
        better part of the map; `localisation`, the standard deviation in px by which noise of the size of their
        difference shifts a match on this texture.
    fine : dict from kind to uint8 (H, W)
        Codes of what the disparities say, 255 where unknown. `left_right`, the difference from the disparity of the
        match; `excess` of the second best cost; `roughness`, the distance from the mean of the neighbouring
        disparities; `breaks`, the share of neighbours around that differ by more than 1 px; `support`, the share of
        valid pixels around.
    valid : bool (H, W)
        Pixels with a disparity whose match lies in the right image. Codes mean something only there.
    density : float
        Valid pixels over those that are neither masked nor sky.
    agreement : float or None
        Mean correlation over the map, by the contrast of the windows: what is flat neither agrees nor disagrees. None
        where nothing is valid.
    edges : float
        Mean log2 of the gradient of the left image where the disparity steps by more than 3 px, over the median
        gradient: objects end where the image has edges, and smoothing moves them away. 0 without steps.
    over_chance : float or None
        How much better the pair matches than one whose right image is upside down (`agreement_over_chance`).
    """

    coarse: dict[str, Codes]
    fine: dict[str, Codes]
    valid: Mask
    density: float
    agreement: float | None
    edges: float
    over_chance: float | None

    def codes(self, kind: str) -> Codes:
        """Return the codes of one kind for every pixel, uint8 (H, W)."""
        return self.fine[kind] if kind in self.fine else spread(self.coarse[kind], self.valid.shape)


def spread(coarse: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Give every pixel of an image of `shape` the value of its pixel on the coarse grid."""
    return np.asarray(cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST))


def gather_evidence(left: Image, right: Image, disparity: Disparity, search: DisparityRange | None) -> Evidence:
    """Gather the evidence for each disparity of a map.

    Parameters
    ----------
    left, right : (H, W) or (H, W, 3), uint8 or uint16
        The images that were matched.
    disparity : Disparity
    search : DisparityRange or None
        What was searched; None where whether the pair matches at all shall not be asked.

    References
    ----------
    X. Hu and P. Mordohai, A quantitative evaluation of confidence measures for stereo vision, IEEE TPAMI 34(11), 2012.
    """
    one, other = (to_8_bit(to_gray(image)) for image in (left, right))
    over_chance = None if search is None else agreement_over_chance(one, other, search.min_px, search.max_px)
    values = disparity.disparity_px
    rows, columns = values.shape
    column = np.arange(columns, dtype=np.float32) - values
    with np.errstate(invalid="ignore"):
        valid = (column >= -0.5) & (column <= columns - 0.5)
    column[~valid] = -1.0
    row = np.repeat(np.arange(rows, dtype=np.float32)[:, None], columns, axis=1)
    smooth = [np.asarray(cv2.GaussianBlur(image, (3, 3), 0), np.uint8) for image in (one, other)]
    noise = _noise_variance(one) + _noise_variance(other)
    coarse, agreement = _photometric(smooth, noise, column, row, valid)
    fine = _geometric(values, valid)
    fine["left_right"] = _left_right(disparity, column, row, valid)
    fine["excess"] = (
        np.full(values.shape, UNKNOWN, np.uint8)
        if disparity.excess is None
        else _code_where_known(disparity.excess, "excess")
    )
    wanted = int(np.count_nonzero((disparity.validity & np.uint16(UNWANTED)) == 0))
    density = int(np.count_nonzero(valid)) / max(wanted, 1)
    return Evidence(coarse, fine, valid, density, agreement, _edges(smooth[0], values), over_chance)


def _photometric(
    smooth: list[Codes], noise_variance: float, column: FloatImage, row: FloatImage, valid: Mask
) -> tuple[dict[str, Codes], float | None]:
    """Compare the left image with the right one sampled at its matches, in windows of valid pixels."""
    some = (slice(None, None, STEP), slice(None, None, STEP))
    warped = np.asarray(cv2.remap(smooth[1], column[some], row[some], cv2.INTER_LINEAR), np.uint8)
    here = np.ascontiguousarray(valid[some])
    weight = here.view(np.uint8)
    one, other = smooth[0][some] * weight, warped * weight
    share = np.float32(1.0) / _at_least(_box(weight), 1.0)
    mean_one, mean_other = _box(one) * share, _box(other) * share
    noise = np.float32(NOISE_VARIANCE)
    spread_one = _at_least(_mean_product(one, one, share) - mean_one * mean_one, 0.0) + noise
    spread_other = _at_least(_mean_product(other, other, share) - mean_other * mean_other, 0.0) + noise
    covariance = _mean_product(one, other, share) - mean_one * mean_other
    correlation = covariance / np.sqrt(spread_one * spread_other)
    deviation_one = np.sqrt(spread_one)
    centred = cv2.subtract(one, mean_one, dtype=cv2.CV_32F) / deviation_one
    centred -= cv2.subtract(other, mean_other, dtype=cv2.CV_32F) / np.sqrt(spread_other)
    misfit = cv2.boxFilter(centred * centred, cv2.CV_32F, (3, 3), borderType=cv2.BORDER_REFLECT_101)
    slope = _twice_the_slope(smooth[0]) * weight
    energy = _mean_product(slope, slope, np.float32(0.25) * share)
    agreeing = _at_least(correlation, 0.0)
    difference = _at_least(1.0 - agreeing, 0.0) * spread_one + 0.1 * noise
    known = np.flatnonzero(here)
    sample = difference.ravel().take(known[:: max(1, known.size // SAMPLE)])
    usual = np.float32(np.percentile(sample, QUARTER)) if known.size else noise
    most = np.float32(noise_variance + NOISE_VARIANCE)
    surprise = difference / (min(usual, most) + np.float32(SHIFT_VARIANCE) * energy)
    shift = difference * share / (energy + np.float32(LEAST_SLOPE))
    codes = {
        "correlation": _code(correlation, "correlation"),
        "misfit": _code(_log2(misfit + np.float32(2.0**-7)), "misfit"),
        "surprise": _code(_log2(surprise), "surprise"),
        "localisation": _code(np.float32(0.5) * _log2(shift), "localisation"),
    }
    contrast = deviation_one * weight
    total = float(contrast.sum())
    return codes, float((contrast * agreeing).sum()) / total if total > 0 else None


def _twice_the_slope(smooth: Codes) -> Codes:
    """Return the absolute difference of the columns beside every second pixel of every second row, 0 at the borders."""
    beside = np.ascontiguousarray(smooth[::STEP, 1::STEP])
    inner = cv2.absdiff(beside[:, 1:], beside[:, :-1])
    return np.asarray(cv2.copyMakeBorder(inner, 0, 0, 1, smooth.shape[1] % STEP, cv2.BORDER_CONSTANT), np.uint8)


def _log2(values: FloatImage) -> FloatImage:
    # numpy has vector instructions for the natural logarithm alone
    return np.asarray(np.log(values) * np.float32(1.0 / np.log(2.0)), np.float32)


def _noise_variance(image: Codes) -> float:
    """Return the variance of what neighbouring pixels do not share, by a part of them; the texture is in it."""
    above, here, below = (image[first : len(image) - 2 + first : 8].astype(np.int16) for first in range(3))
    column = above - 2 * here + below
    rest = (column[:, :-2] - 2 * column[:, 1:-1] + column[:, 2:])[:, ::3]
    return float(np.median(np.abs(rest)) / (6 * MEDIAN_OF_NORMAL)) ** 2 if rest.size else 0.0


def _edges(smooth: Codes, values: FloatImage) -> float:
    """Return the mean log2 of the gradient at steps of the disparity over the median gradient; every second row."""
    rows = np.ascontiguousarray(smooth[::STEP])
    slope = cv2.absdiff(rows[:, 2:], rows[:, :-2])  # twice that of all columns but the first and the last
    known = np.ascontiguousarray(values[::STEP])
    at = np.flatnonzero(cv2.absdiff(known[:, 2:-1], known[:, 1:-2]) > STEP_PX)
    if not at.size:
        return 0.0
    at += at // (values.shape[1] - 3)  # a row of slopes has one more
    here = np.float32(0.5) * np.maximum(slope.ravel().take(at), slope.ravel().take(at + 1))
    usual = 0.5 * float(np.median(slope[::4, ::4]))
    return float(np.mean(np.log2((here + FLAT_DN) / (usual + FLAT_DN))))


def _geometric(values: FloatImage, valid: Mask) -> dict[str, Codes]:
    """Compare each disparity with its neighbours."""
    weight = valid.view(np.uint8)
    known = cv2.copyTo(values, weight)  # 0 elsewhere
    mean = _box(known, SURFACE_PX) / _at_least(_box(weight, SURFACE_PX), 1.0)
    broken = np.zeros(values.shape, bool)
    broken[:, 1:] = cv2.absdiff(values[:, 1:], values[:, :-1]) > BREAK_PX
    broken[1:] |= cv2.absdiff(values[1:], values[:-1]) > BREAK_PX
    return {
        "roughness": _code(cv2.absdiff(mean, known), "roughness"),
        "breaks": _share(broken, SURFACE_PX),
        "support": _share(valid, NEIGHBOURHOOD_PX),
    }


def _share(where: Mask, side: int) -> Codes:
    """Return the code of the share of pixels of the window around each."""
    codes = where * np.uint8(LAST_CODE)
    return np.asarray(cv2.boxFilter(codes, -1, (side, side), borderType=cv2.BORDER_REFLECT_101), np.uint8)


def _left_right(disparity: Disparity, column: FloatImage, row: FloatImage, valid: Mask) -> Codes:
    """Compare each disparity with that of its match."""
    if disparity.right_px is None:
        return np.full(valid.shape, UNKNOWN, np.uint8)
    back = cv2.remap(disparity.right_px, column, row, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    return _code_where_known(cv2.absdiff(back, disparity.disparity_px), "left_right")


def _code(values: NDArray[Any], kind: str) -> Codes:
    """Return values, none of them NaN, as codes of their kind."""
    low, high = SCALES[kind]
    if low:
        values = _at_least(values - np.float32(low), 0.0)
    codes = cv2.convertScaleAbs(values, alpha=LAST_CODE / (high - low))
    codes -= (codes == UNKNOWN).view(np.uint8)  # what saturates is known
    return np.asarray(codes, np.uint8)


def _code_where_known(values: NDArray[Any], kind: str) -> Codes:
    """Return values as codes of their kind; NaN is unknown."""
    codes = _code(values, kind)
    codes |= np.negative(np.isnan(values).view(np.uint8))  # all bits of `UNKNOWN` are set
    return codes


def _at_least(values: FloatImage, low: float) -> FloatImage:
    """Return the larger of each value and `low`; `np.maximum` takes up to four times as long."""
    return np.asarray(cv2.max(values, low), np.float32)  # type: ignore[call-overload]


def _box(image: NDArray[Any], side: int = WINDOW) -> FloatImage:
    total = cv2.boxFilter(image, cv2.CV_32F, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(total, np.float32)


def _mean_product(one: Codes, other: Codes, share: FloatImage) -> FloatImage:
    """Return the mean of the products in the window around each pixel; `share` is one over its number of pixels."""
    return _box(np.multiply(one, other, dtype=np.uint16)) * share
