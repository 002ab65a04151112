"""The subject of all pair probes: a pair with its shared intermediates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement._corresponding import Corresponding, LightFit, corresponding_blocks, fit_light
from modules.primitives.coarse import CoarseMatch, coarse_factor, coarse_match
from modules.primitives.features import match_features, track_corners
from modules.primitives.noise import NoiseBlocks, estimate_noise_dn, noise_blocks
from modules.primitives.photometry import common_view, dominant_shift_px, seen_alone, shrink, to_8_bit, to_gray
from modules.primitives.rows import RowFit, fit_rows
from modules.primitives.statistics import Floats, count_levels
from modules.primitives.stuck import find_columns
from modules.primitives.warp import row_alignment_map, warp
from modules.types import Correspondences, DisparityRange, Image, Views

Gray = NDArray[np.uint8]
Indices = NDArray[np.int64]

HISTOGRAM_PX = 90_000  # pixels that suffice for histograms
SEARCH = (-0.25, 0.45)  # disparities of the coarse match as fractions of the width; negative: swapped or toed in
SEARCH_MARGIN_PX = 8  # around a given range
TRACKABLE_FRACTION = 0.45  # of the thumbnail matches; clean pairs 0.6 and more, rows 12 px off at most 0.44
TRUSTED_FRACTION = 0.2  # of the corners agree on one row model; clean pairs 0.5 and more, unrelated ones 0.01
TRUSTED_RESIDUAL = 0.0007  # of the width; clean pairs 0.00024, corners astray where rows are far off 0.0022
SOUND_FRACTION = 0.5  # of the thumbnail matches where rows are not far off; then nothing needs aligning
COARSE_ROW_ERROR_PX = 1.0  # of the thumbnail; rows that are off by more are aligned before matching again


@dataclass(frozen=True)
class FeatureMatches:
    """Sparse matches of a pair and the number of features they come from."""

    matches: Correspondences
    left_count: int
    right_count: int
    fit: RowFit | None

    @property
    def agreeing(self) -> Correspondences:
        """The matches that agree with the row model; none without a model."""
        if self.fit is None:
            none = np.zeros((0, 2), np.float32)
            return Correspondences(none, none)
        keep = self.fit.inliers
        return Correspondences(self.matches.left_xy[keep], self.matches.right_xy[keep])

    @property
    def agreeing_fraction(self) -> float:
        """Matches that agree with the row model over the features of the poorer image."""
        return min(1.0, len(self.agreeing) / max(1, min(self.left_count, self.right_count)))


class Sample:
    """A pair and the intermediates that several probes need, each computed once and only when asked for.

    Parameters
    ----------
    views : Views
        Images of one shape and dtype. Rows and columns that the masks exclude in both images are cut off first, so that
        padding changes no fact.
    given_range : DisparityRange, optional
        Range of disparities given with the pair.
    """

    def __init__(self, views: Views, given_range: DisparityRange | None = None) -> None:
        self.full_shape = views.shape
        self.origin, self.views = _without_padding(views)
        self.given_range = given_range

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the part that is measured."""
        return self.views.shape

    @property
    def channels(self) -> int:
        """Number of channels, 1 or 3."""
        return 1 if self.views.left.ndim == 2 else int(self.views.left.shape[2])

    @cached_property
    def gray8(self) -> tuple[Gray, Gray]:
        """Left and right luminance, uint8 (H, W)."""
        return to_8_bit(to_gray(self.views.left)), to_8_bit(to_gray(self.views.right))

    @cached_property
    def half(self) -> tuple[Gray, Gray]:
        """Left and right luminance at half size, uint8 (about H/2, W/2)."""
        return _halved(self.gray8[0]), _halved(self.gray8[1])

    @cached_property
    def quarter(self) -> tuple[Gray, Gray]:
        """Left and right luminance at quarter size, uint8 (about H/4, W/4)."""
        return _halved(self.half[0]), _halved(self.half[1])

    @cached_property
    def shift_px(self) -> int:
        """Column shift between the contents of the images: middle of the given range, or estimated."""
        if self.given_range is not None:
            return (self.given_range.min_px + self.given_range.max_px) // 2
        return dominant_shift_px(*self.quarter) * 4

    @cached_property
    def rows(self) -> tuple[Gray, Gray]:
        """Every few rows of the images on the 0-255 scale, left and right.

        Whole rows, because single pixels out of rows of colours take as long as all of them.
        """
        left, right = (to_8_bit(image[:: self._row_step]) for image in (self.views.left, self.views.right))
        return left, right

    @cached_property
    def gray_rows(self) -> tuple[Gray, Gray]:
        """The same rows of the luminance, left and right."""
        return self.gray8[0][:: self._row_step], self.gray8[1][:: self._row_step]

    @cached_property
    def counts(self) -> dict[str, tuple[Floats, Floats]]:
        """Histograms of those rows by channel name, float64 (256,), left and right; `gray` and any colours."""
        return self._count(self.gray_rows, self.rows)

    @cached_property
    def common_counts(self) -> dict[str, tuple[Floats, Floats]]:
        """The same of the columns that both images see: of all columns, less those that one sees alone."""
        alone = self._count(seen_alone(*self.gray_rows, self.shift_px), seen_alone(*self.rows, self.shift_px))
        return {name: (left - alone[name][0], right - alone[name][1]) for name, (left, right) in self.counts.items()}

    @cached_property
    def common_quarter(self) -> tuple[Gray, Gray]:
        """The quarter-size luminance, cut to the columns that both images see."""
        return common_view(*self.quarter, round(self.shift_px / 4))

    @cached_property
    def noise_blocks(self) -> tuple[NoiseBlocks, NoiseBlocks]:
        """Noise by block of the green channel, or of the gray image, left and right."""
        left, right = self.gray8
        if self.channels == 3:
            left, right = (to_8_bit(cast(Image, cv2.extractChannel(x, 1))) for x in (self.views.left, self.views.right))
        return noise_blocks(left), noise_blocks(right)

    @cached_property
    def middle_noise_dn(self) -> tuple[float, float]:
        """Noise of the luminance in the middle half of the rows, where detail is compared, left and right, dn."""
        height = self.shape[0]
        left, right = (estimate_noise_dn(gray[height // 4 : height - height // 4]) for gray in self.gray8)
        return left, right

    @cached_property
    def lines(self) -> tuple[tuple[Indices, Indices], tuple[Indices, Indices]]:
        """Rows and columns that stand out from both neighbours, left and right."""
        left, right = ((find_columns(gray.T), find_columns(gray)) for gray in self.gray8)
        return left, right

    @cached_property
    def first_coarse(self) -> CoarseMatch | None:
        """A dense match of thumbnails of the images as they are, over half the width or around the given range."""
        return self._match_coarsely(self.gray8[1])

    @cached_property
    def features(self) -> FeatureMatches:
        """Sparse matches with the row model fitted to them.

        Corners are tracked from the coarse match; where few agree on one row model, as with rows that are far off,
        features are matched over the whole image, which takes ten times as long.
        """
        if self.first_coarse is not None and self.first_coarse.valid_fraction >= TRACKABLE_FRACTION:
            matches, corners = track_corners(*self.gray8, self.first_coarse)
            tracked = FeatureMatches(matches, corners, corners, fit_rows(matches, self.shape))
            limit_px = max(0.5, TRUSTED_RESIDUAL * self.shape[1])
            sure = tracked.fit is not None and tracked.fit.residual_px <= limit_px
            if sure and tracked.agreeing_fraction >= TRUSTED_FRACTION:
                return tracked
        matches, (left, right) = match_features(*self.gray8)
        return FeatureMatches(matches, left, right, fit_rows(matches, self.shape))

    @cached_property
    def coarse(self) -> CoarseMatch | None:
        """The coarse match; matched again with aligned rows where they are too far off for it."""
        if self.aligned_right is self.views.right:
            return self.first_coarse
        return self._match_coarsely(to_8_bit(to_gray(self.aligned_right))) or self.first_coarse

    @cached_property
    def aligned_right(self) -> Image:
        """The right image; its rows aligned if they are too far off for the coarse match."""
        first = self.first_coarse
        if first is not None and first.valid_fraction >= SOUND_FRACTION:
            return self.views.right
        fit = self.features.fit
        if fit is None or fit.model.max_abs_px(self.shape) * coarse_factor(self.shape) <= COARSE_ROW_ERROR_PX:
            return self.views.right
        return warp(self.views.right, *row_alignment_map(fit.model, self.shape))[0]

    @cached_property
    def blocks(self) -> Corresponding | None:
        """Means of corresponding blocks; None without a coarse match."""
        match = self.coarse
        if match is None:
            return None
        colours = None
        if self.channels == 3:
            size = (match.left.shape[1], match.left.shape[0])
            left, right = (to_8_bit(image) for image in (self.views.left, self.aligned_right))
            colours = (shrink(left, *size), shrink(right, *size))
        return corresponding_blocks(match, colours)

    @cached_property
    def light(self) -> LightFit | None:
        """The light difference of corresponding blocks by tone and place."""
        return None if self.blocks is None else fit_light(self.blocks)

    @property
    def _row_step(self) -> int:
        return max(1, round(self.shape[0] * self.shape[1] / HISTOGRAM_PX))

    def _count(self, gray: tuple[Gray, Gray], rows: tuple[Gray, Gray]) -> dict[str, tuple[Floats, Floats]]:
        """Return the histograms of the luminance and of the colours, if there are any, by channel name."""
        counts = {"gray": (count_levels(gray[0]), count_levels(gray[1]))}
        if self.channels == 3:
            counts.update(
                (name, (count_levels(rows[0], channel), count_levels(rows[1], channel)))
                for channel, name in enumerate(("red", "green", "blue"))
            )
        return counts

    def _match_coarsely(self, right: Gray) -> CoarseMatch | None:
        if self.given_range is not None:
            low, high = self.given_range.min_px - SEARCH_MARGIN_PX, self.given_range.max_px + SEARCH_MARGIN_PX
        else:
            low, high = (round(fraction * self.shape[1]) for fraction in SEARCH)
        return coarse_match(self.gray8[0], right, low, high)


def _without_padding(views: Views) -> tuple[tuple[int, int], Views]:
    """Return the first row and column that a mask allows, and the views from there to the last."""
    masks = [mask for mask in (views.left_mask, views.right_mask) if mask is not None]
    if len(masks) < 2 or not (used := masks[0] | masks[1]).any():
        return (0, 0), views
    rows, columns = np.flatnonzero(used.any(axis=1)), np.flatnonzero(used.any(axis=0))
    part = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))
    left, right = (cast(Image, np.ascontiguousarray(image[part])) for image in (views.left, views.right))
    return (part[0].start, part[1].start), Views(left, right, masks[0][part], masks[1][part])


def _halved(image: Gray) -> Gray:
    height, width = image.shape
    return shrink(image, max(1, width // 2), max(1, height // 2))
