"""What the matchers share: checked inputs, 8-bit images, padding for OpenCV, and reasons for invalid pixels."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.operator import OperatorError
from modules.types import Disparity, DisparityRange, FloatImage, Invalid, Mask, Matching, Views, blanked, flagged

Pixel = TypeVar("Pixel", bound=np.generic)
Case = TypeVar("Case")
Result = TypeVar("Result")
Bytes = NDArray[np.uint8]
ComputeFixedPoint = Callable[[Bytes, Bytes, int, int], NDArray[np.int16]]

FIXED_POINT_STEPS = 16  # OpenCV's matchers return disparities as int16 in 1/16 px
OPENCV_STEP = 16  # OpenCV wants the number of disparities to be a multiple of this
CLIPPED_SHARE = 0.001  # share of the pixels at either end that the conversion from 16 to 8 bit may clip


def checked_range(state: Matching, window_px: int, name: str) -> DisparityRange:
    """Return the range to search after checking that the images can be matched with it.

    Raises
    ------
    OperatorError
        If there is no range, the images differ in shape, are not of 8 or 16 bit or have a mask of another shape, the
        window is larger than the image, the range is wider than the image or leaves no overlap, or an image is
        constant.
    """
    left, right = state.views.left, state.views.right
    _check_arrays(state.views, name)
    if state.range_px is None:
        raise OperatorError(f"{name}: no disparity range is known; run matching.use_range first")
    rows, columns = state.views.shape
    if window_px > min(rows, columns):
        raise OperatorError(
            f"{name}: the window of {window_px} px does not fit the image of {columns}x{rows} px; use a smaller window "
            "or a larger image"
        )
    search = state.range_px
    if search.count > columns or search.min_px >= columns or search.max_px <= 1 - columns:
        raise OperatorError(
            f"{name}: the disparity range {search.min_px} to {search.max_px} px does not fit the image width of "
            f"{columns} px; use a narrower range that leaves the images some overlap"
        )
    for side, image in (("left", left), ("right", right)):
        if image.min() == image.max():
            raise OperatorError(
                f"{name}: the {side} image has the one value {int(image.flat[0])} everywhere, at least 2 are needed; "
                "take another image"
            )
    return search


def _check_arrays(views: Views, name: str) -> None:
    """Raise an OperatorError that names everything that is wrong with the images and masks."""
    left, right = views.left, views.right
    wrong = []
    if left.shape != right.shape or left.dtype != right.dtype:
        wrong.append(
            f"left is {left.shape} {left.dtype} and right is {right.shape} {right.dtype}; bring both to one shape and "
            "dtype first"
        )
    if left.dtype not in (np.uint8, np.uint16):
        wrong.append(f"the images are {left.dtype}; scale them to uint8 or uint16")
    for side, mask in (("left", views.left_mask), ("right", views.right_mask)):
        if mask is not None and (mask.shape != views.shape or mask.dtype != np.bool_):
            wrong.append(
                f"the {side} mask is {mask.shape} {mask.dtype}, the image {views.shape}; give a bool mask of that shape"
            )
    if wrong:
        raise OperatorError(f"{name}: " + "; ".join(wrong))


def to_bytes(views: Views, colour: bool) -> tuple[Bytes, Bytes]:
    """Return both images as uint8, gray or RGB.

    Parameters
    ----------
    views : Views
        Images (H, W) or (H, W, 3), uint8 or uint16.
    colour : bool
        Keep three channels where there are three; else convert to gray with the weights of BT.601.

    Returns
    -------
    left, right : uint8 (H, W) or (H, W, 3)
        16-bit images are mapped by one linear map for both, so that equal values stay equal; it spans the values
        between the lowest and highest 0.1 % of the two images together.
    """
    images = [
        image if colour or image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        for image in (views.left, views.right)
    ]
    if images[0].dtype == np.uint8:
        return np.asarray(images[0], np.uint8), np.asarray(images[1], np.uint8)
    both = np.stack(images)
    low, high = np.quantile(both, (CLIPPED_SHARE, 1.0 - CLIPPED_SHARE))
    if high <= low:
        low, high = float(both.min()), float(both.max())
    scale = 255.0 / max(high - low, 1.0)
    left, right = (np.clip(np.rint((i.astype(np.float32) - low) * scale), 0, 255).astype(np.uint8) for i in images)
    return left, right


def match_padded(
    compute: ComputeFixedPoint, left: Bytes, right: Bytes, search: DisparityRange, margin_px: int
) -> FloatImage:
    """Run an OpenCV matcher without losing the columns and rows that it leaves out at the border.

    OpenCV matches only where the whole range lies inside the right image. Both images are therefore extended by
    replicating their border, by no more than is needed, and the result is cropped. The number of disparities is rounded
    up to a multiple of 16.

    Parameters
    ----------
    compute : callable
        `(left, right, min_disparity, count) -> int16` in 1/16 px.
    left, right : uint8 (H, W) or (H, W, 3)
    search : DisparityRange
    margin_px : int
        Further columns and rows that the matcher leaves out on each side.

    Returns
    -------
    float32 (H, W)
        Disparity in px, NaN where the matcher gave none; may lie outside the range by the rounding up, and matches may
        lie outside the right image.
    """
    rows, columns = left.shape[:2]
    count = -(-search.count // OPENCV_STEP) * OPENCV_STEP
    before = max(search.min_px + count, 0) + margin_px
    after = max(-search.min_px, 0) + margin_px
    padded = [
        cv2.copyMakeBorder(image, margin_px, margin_px, before, after, cv2.BORDER_REPLICATE) for image in (left, right)
    ]
    fixed = compute(np.asarray(padded[0], np.uint8), np.asarray(padded[1], np.uint8), search.min_px, count)
    fixed = fixed[margin_px : margin_px + rows, before : before + columns]
    disparity = fixed.astype(np.float32)
    disparity *= np.float32(1.0 / FIXED_POINT_STEPS)
    return blanked(disparity, fixed < search.min_px * FIXED_POINT_STEPS)


def match_both(
    compute: ComputeFixedPoint, left: Bytes, right: Bytes, search: DisparityRange, margin_px: int, with_right: bool
) -> tuple[FloatImage, FloatImage | None]:
    """Return the disparities of the left image and, if wanted, of the right one by matching the mirrored pair."""
    disparity = match_padded(compute, left, right, search, margin_px)
    if not with_right:
        return disparity, None
    mirrored = [np.ascontiguousarray(image[:, ::-1]) for image in (right, left)]
    right_px = match_padded(compute, mirrored[0], mirrored[1], search, margin_px)[:, ::-1]
    return disparity, np.ascontiguousarray(right_px)


def at_match(values: NDArray[Pixel], disparity: FloatImage) -> tuple[NDArray[Pixel], Mask]:
    """Return `values` of the right image at the nearest pixel to each left pixel's match, and where that exists.

    Parameters
    ----------
    values : (H, W)
        Indexed by right row and column.
    disparity : float32 (H, W)
        px, NaN where there is none.

    Returns
    -------
    found : (H, W)
        Any of the values where there is no such pixel.
    known : bool (H, W)
    """
    rows, columns = disparity.shape
    column = np.arange(columns, dtype=np.float32) - disparity
    np.rint(column, out=column)
    with np.errstate(invalid="ignore"):
        known = (column >= 0) & (column < columns)
        index = column.astype(np.int32)
    index += np.arange(0, rows * columns, columns, dtype=np.int32)[:, None]
    return values.ravel().take(index, mode="clip"), known


def assemble(
    state: Matching,
    disparity: FloatImage,
    right_px: FloatImage | None,
    reject_range_border: bool,
    excess: FloatImage | None = None,
    reasons: NDArray[np.uint16] | None = None,
) -> Matching:
    """Turn raw disparities into the product: every pixel without a disparity gets its reason.

    Parameters
    ----------
    state : Matching
        With a range.
    disparity : float32 (H, W)
        Raw disparities, px, NaN where the matcher gave none.
    right_px : float32 (H, W) or None
        Raw disparities of the right image.
    reject_range_border : bool
        Reject also the pixels whose best disparity is the first or last of the range.
    excess : float32 (H, W) or None
        Of the second best cost over the best one.
    reasons : uint16 (H, W) or None
        Flags of pixels that the matcher itself rejects.
    """
    search = state.range_px
    if search is None:
        raise OperatorError("matching: no disparity range is known; run matching.use_range first")
    views = state.views
    flags = np.zeros(disparity.shape, np.uint16) if reasons is None else reasons.copy()
    _flag_values(disparity, flags, search, reject_range_border)
    if views.left_mask is not None:
        flags |= flagged(~views.left_mask, Invalid.MASKED)
    if views.right_mask is not None:
        usable, known = at_match(views.right_mask, disparity)
        flags |= flagged(known & ~usable, Invalid.MASKED)
    inside = np.clip(disparity, np.float32(search.min_px), np.float32(search.max_px - 1))
    if right_px is not None and views.right_mask is not None:
        right_px = blanked(right_px, ~views.right_mask)
    return replace(state, disparity=Disparity(blanked(inside, flags != 0), flags, right_px=right_px, excess=excess))


def _flag_values(
    disparity: FloatImage, flags: NDArray[np.uint16], search: DisparityRange, reject_range_border: bool
) -> None:
    """Add to flags (H, W) what is wrong with raw disparities (H, W): missing, beyond the range, outside the image."""
    columns = disparity.shape[1]
    inset = np.float32(0.5 if reject_range_border else -0.5)
    low, high = search.min_px + inset, search.max_px - 1 - inset
    # NaN is neither below nor above a bound.
    flags |= flagged(np.isnan(disparity) & (flags == 0), Invalid.NO_MATCH)
    flags |= flagged((disparity < low) | (disparity > high), Invalid.RANGE_BORDER)
    across = np.arange(columns, dtype=np.float32)
    first = min(search.max_px + OPENCV_STEP, columns)  # columns from there on match inside, even rounded up
    if first > 0:
        left = slice(0, first)
        flags[:, left] |= flagged(disparity[:, left] > across[left] + np.float32(0.5), Invalid.OUTSIDE)
    last = max(columns - 1 + search.min_px, 0)  # columns up to there match inside
    if last < columns:
        right = slice(last, columns)
        flags[:, right] |= flagged(disparity[:, right] < across[right] - np.float32(columns - 0.5), Invalid.OUTSIDE)


def do_all(pool: ThreadPoolExecutor | None, work: Callable[[Case], Result], cases: Iterable[Case]) -> list[Result]:
    """Return the work done on every case, by the threads of a pool or, without one, one after the other."""
    return list(map(work, cases) if pool is None else pool.map(work, cases))


def halves(rows: int) -> tuple[slice, slice]:
    """Return the upper and the lower half of the rows, for two threads."""
    return slice(0, rows // 2), slice(rows // 2, rows)


def require_disparity(state: Matching, name: str) -> Disparity:
    """Return the disparity of the state.

    Raises
    ------
    OperatorError
        If no matcher has run.
    """
    if state.disparity is None:
        raise OperatorError(f"{name}: there is no disparity yet; run a matcher first")
    return state.disparity
