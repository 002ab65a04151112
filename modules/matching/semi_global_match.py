"""Match semi-globally with a cost that survives radiometric differences."""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from typing import Literal, cast

import cv2
import numpy as np
from pydantic import Field

from modules.matching.aggregation import LARGEST_SHIFT_PX, Problem, Selection, aggregate, plan_storage
from modules.matching.coarse_to_fine import confirmed_coarse, match_tiles, plan_tiles
from modules.matching.common import Bytes, assemble, checked_range, to_bytes
from modules.matching.features import FINENESS, CensusName, CostName, compute_features, smooth_levels, window_of
from modules.matching.refine_subpixel import Window, refine_by_intensity
from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.primitives.photometry import to_8_bit
from modules.primitives.threads import allowed_threads
from modules.types import DisparityRange, Image, Invalid, Matching, Views

LARGEST_COST = 36.0  # costs are cut off here: two unrelated windows seldom differ by more, bits of census
LEVELS = 255  # path costs are bytes: the largest cost and the largest penalty together
MOST_LEVELS_PER_BIT = 6.0  # more tell nothing
CURVES = {"parabola": 0, "equiangular": 1, "intensity": 2}  # as the kernels number them
NAME = "matching.semi_global_match"

_log = logging.getLogger(__name__)


class SemiGlobalMatchParams(OperatorParams):
    """Parameters of `semi_global_match`."""

    cost: CostName = Field(
        "hybrid",
        description="Census and half the difference of horizontal derivatives; census, with or without a margin; "
        "horizontal derivatives alone; or intensities, for images of one exposure",
    )
    census: CensusName = Field(
        "9x9_sparse",
        description="Window of the census, columns x rows, px; sparse: every second pixel and those around the centre",
    )
    smooth_px: float = Field(
        0.5, ge=0.0, le=3.0, description="Sigma of the smoothing before the cost and the steps of the image, px"
    )
    margin_dn: int = Field(2, ge=0, le=64, description="Smaller differences are none to the ternary census, DN")
    window_px: int = Field(5, ge=1, le=11, description="Side of the window that averages the cost, odd, px")
    paths: Literal[4, 8] = Field(8, description="Directions along which the disparity shall be smooth; 4 leave streaks")
    shift_px: int = Field(
        1,
        ge=0,
        le=LARGEST_SHIFT_PX,
        description="How far that window may be shifted to where it costs least, px; it then lies beside edges",
    )
    p1: float = Field(14.0, ge=0.0, le=40.0, description="P1, penalty of a step of 1 px on even ground, bits of census")
    p1_decay_per_dn: float = Field(
        0.05,
        ge=0.0,
        le=1.0,
        description="P1 is divided by 1 + this x step of the left image along the path, 1/DN on 0-255 of full scale",
    )
    p2: float = Field(90.0, ge=0.0, le=160.0, description="P2, penalty of a larger step on even ground, bits of census")
    p2_decay_per_dn: float = Field(0.1, ge=0.0, le=1.0, description="P2 is divided by 1 + this x that step, 1/DN")
    subpixel: Literal["parabola", "equiangular", "intensity"] = Field(
        "intensity",
        description="Curve fitted at the least cost, or lines refined by intensities, which locks least to whole px",
    )
    refine_px: int = Field(5, ge=3, le=15, description="Width of the window of that refinement, odd, px")
    refine_rows_px: int = Field(5, ge=3, le=15, description="Height of the window of that refinement, odd, px")
    refine_passes: int = Field(
        1, ge=1, le=8, description="Steps of that refinement; noise damps each, so it needs more"
    )
    refine_misfit: float = Field(
        5.0,
        ge=1.0,
        le=20.0,
        description="Weight of its misfit as noise: 1 for noise of single pixels, more where neighbours err alike",
    )
    gray: Literal["luminance", "mean"] = Field(
        "luminance",
        description="Gray of colour images: weights of BT.601, or equal ones, which leave less noise",
    )
    coarse_to_fine: bool = Field(
        False, description="Match half-size images first and give each tile its range: for large images and ranges"
    )
    threads: Literal[1, 2] = Field(
        2, description="Most threads, within `cv2.setNumThreads`; the result does not depend on them"
    )
    max_memory_mb: int = Field(400, ge=1, le=65536, description="Most memory for path costs, MB; less takes longer")
    reject_range_border: bool = Field(False, description="Reject pixels whose best disparity is an end of the range")


def state_problem(
    left: Bytes,
    right: Bytes,
    search: DisparityRange,
    params: SemiGlobalMatchParams,
    pool: ThreadPoolExecutor | None = None,
    guide: Bytes | None = None,
) -> Problem:
    """Return the problem of a gray pair (H, W) as the kernels want it.

    `guide` is the left image (H, W, 3) whose steps select the penalties; the gray one if there is none. Path costs are
    bytes, so the penalties decide how finely a cost can be told: 2.0 levels per bit by default.
    """
    found = compute_features(
        left, right, search.min_px, search.count, params.cost, params.census, params.smooth_px, params.margin_dn, pool
    )
    levels = min(LEVELS / (LARGEST_COST + params.p2), MOST_LEVELS_PER_BIT)
    steps = np.arange(256)
    p1 = np.floor(params.p1 * levels / (1.0 + params.p1_decay_per_dn * steps))
    p2 = np.maximum(np.floor(params.p2 * levels / (1.0 + params.p2_decay_per_dn * steps)), p1)
    return Problem(
        left=found.left,
        right=found.right,
        before=found.before,
        low=search.min_px,
        searched=search.count,
        bit_shift=found.bit_shift,
        value_limit=found.value_limit,
        radius=params.window_px // 2,
        levels=levels / found.unit,
        most=int(LARGEST_COST * levels),
        guide=_planes(left if guide is None else guide, params.smooth_px),
        p1_of_step=p1.astype(np.uint8),
        p2_of_step=p2.astype(np.uint8),
        diagonals=params.paths == 8,
        curve=CURVES[params.subpixel],
        shift=params.shift_px,
    )


def _planes(image: Bytes, smooth_px: float) -> Bytes:
    """Return the smoothed planes (C, H, W) of an image (H, W) or (H, W, 3)."""
    planes = [image] if image.ndim == 2 else [image[..., k] for k in range(image.shape[2])]
    return np.stack([(smooth_levels(plane, smooth_px) + FINENESS // 2) // FINENESS for plane in planes]).astype(
        np.uint8
    )


def match_gray(
    left: Bytes, right: Bytes, search: DisparityRange, params: SemiGlobalMatchParams, guide: Bytes | None = None
) -> Selection:
    """Match a gray pair.

    Parameters
    ----------
    left, right : uint8 (H, W)
    search : DisparityRange
    params : SemiGlobalMatchParams
    guide : uint8 (H, W, 3), optional
        The left image in colour, whose edges tell more about where objects end.

    Returns
    -------
    Selection

    Raises
    ------
    OperatorError
        If the memory does not suffice.
    """
    _announce_compilation()
    with ThreadPoolExecutor(2) if allowed_threads(params.threads) == 2 else nullcontext() as pool:
        found = _match_levels(left, right, search, params, pool, guide)
        if params.subpixel != "intensity":
            return found
        window = Window(params.refine_px // 2, params.refine_rows_px // 2, params.refine_passes, params.refine_misfit)
        refined = refine_by_intensity(left, right, found.disparity, search, pool, window)
    return replace(found, disparity=refined)


def _announce_compilation() -> None:
    """Say that the first call takes long, where it will."""
    from modules.matching.kernels.compiler import will_compile
    from modules.matching.kernels.sweeps import sweep_rows

    if will_compile(sweep_rows):
        _log.warning("%s: compiling its kernels for this processor, once, for about ten seconds", NAME)


def _match_levels(
    left: Bytes,
    right: Bytes,
    search: DisparityRange,
    params: SemiGlobalMatchParams,
    pool: ThreadPoolExecutor | None,
    guide: Bytes | None,
) -> Selection:
    """Match at once, or coarsely first."""

    def match(one: Bytes, other: Bytes, wanted: DisparityRange, guide: Bytes | None = None) -> Selection:
        storage = plan_storage(one.shape, wanted.count, params.max_memory_mb, NAME, params.shift_px)
        return aggregate(state_problem(one, other, wanted, params, pool, guide), storage, pool)

    if not params.coarse_to_fine:
        return match(left, right, search, guide)
    tiles = plan_tiles(confirmed_coarse(left, right, search, match), left.shape, search)
    each_mb = params.max_memory_mb // params.threads  # a thread matches one tile at a time
    storages = [plan_storage(tile.shape, tile.search.count, each_mb, NAME, params.shift_px) for tile in tiles]
    return match_tiles(state_problem(left, right, search, params, pool, guide), tiles, storages, pool)


def _mixed(views: Views, gray: Literal["luminance", "mean"]) -> Views:
    """Return views whose images are the mean of their channels, where that is wanted."""
    if gray == "luminance" or views.left.ndim == 2:
        return views
    third = np.full((1, 3), 1.0 / 3.0, np.float32)
    left, right = (cast(Image, cv2.transform(image, third).reshape(views.shape)) for image in (views.left, views.right))
    return views.with_images(left, right)


def semi_global_match(state: Matching, params: SemiGlobalMatchParams) -> Matching:
    """Match by census and horizontal derivatives with a smoothness penalty along eight paths.

    Parameters
    ----------
    state : Matching
        Views (H, W) or (H, W, 3), uint8 or uint16, and a range. Colour is converted to gray.
    params : SemiGlobalMatchParams

    Returns
    -------
    Matching
        With disparity float32 (H, W), NaN where invalid, its reasons, the excess of the second best cost, and the
        disparity of the right image from the same costs. Where the cost does not depend on the disparity the reason is
        `Invalid.FLAT_MINIMUM`.

    Raises
    ------
    OperatorError
        If the window is even, P2 is smaller than P1, the images or the range cannot be matched, or the memory does not
        suffice for a strip of the image.

    Notes
    -----
    Windows shift to one side of edges, and penalties fall where the left image, in colour if it is, steps along a path:
    on quiet development pairs each saves 0.2 % of the pixels (`examples/evidence/edges.py`). Immune to every smooth
    change of brightness; noise harms it more than `semi_global_block_match`: enlarge the window.
    A curve through the least costs pulls fractions of a pixel towards whole ones; on rendered terrain the median error
    falls from 0.08 to 0.04 px when intensities refine it, and real pairs have fewer errors above 0.25 px too.
    The result depends neither on `threads` nor on `max_memory_mb`; with less than two bytes per pixel and disparity
    costs are computed twice, with less than one sums too.

    References
    ----------
    H. Hirschmueller, Stereo Processing by Semiglobal Matching and Mutual Information, IEEE TPAMI 30(2), 2008.
    A. Bobick and S. Intille, Large occlusion stereo, International Journal of Computer Vision 33(3), 1999.
    R. Zabih and J. Woodfill, Non-parametric local transforms for computing visual correspondence, ECCV 1994.
    """
    for side in ("window_px", "refine_px", "refine_rows_px"):
        if (value := getattr(params, side)) % 2 == 0:
            raise OperatorError(f"{NAME}: {side} {value} is even; use {value + 1}")
    if params.p2 < params.p1:
        raise OperatorError(f"{NAME}: p2 {params.p2:g} is smaller than p1 {params.p1:g}; use a larger p2")
    search = checked_range(state, max(params.window_px, window_of(params.cost, params.census)), NAME)
    left, right = to_bytes(_mixed(state.views, params.gray), colour=False)
    found = match_gray(left, right, search, params, to_8_bit(state.views.left))
    flat = np.isnan(found.ratio)
    reasons = np.where(flat, np.uint16(Invalid.FLAT_MINIMUM), np.uint16(0)).astype(np.uint16)
    excess = np.maximum(found.ratio - np.float32(1.0), np.float32(0.0))
    return assemble(state, found.disparity, found.right_px, params.reject_range_border, excess, reasons)


OPERATOR = Operator(
    name=NAME,
    slot="matcher",
    params=SemiGlobalMatchParams,
    function=semi_global_match,
    cost=Cost(fixed_ms=2.0, ns_per_pixel=55.0, ns_per_pixel_disparity=1.9),
    summary="Match by census and horizontal derivatives along eight paths.",
    suits="The most accurate matcher, immune to brightness differences; slower, and heavy noise needs a larger window.",
    needs=("numba",),
)
