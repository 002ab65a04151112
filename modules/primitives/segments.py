"""Steep edge segments of an image, and which of them correspond between the images of a pair."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.photometry import normalise_contrast

Gray = NDArray[np.uint8]
Floats = NDArray[np.float32]

LEAST_ROWS = 6  # shorter segments match by chance
LARGEST_COUNT = 400  # segments kept per image, the longest first
EDGE_SHARE = 0.12  # share of the pixels whose gradient is strong enough to begin an edge
SLOPES = (-0.35, 0.35)  # rows over columns of the gradient between which a segment counts as upright
STEEPEST = 1.0  # gradients nearer to the vertical belong to edges along the row, which stereo cannot place
REACH_PX = 6  # profile across the edge
DAMPING_DN = 3.0
LEAST_LIKENESS, LEAST_LEAD = 0.75, 0.03  # correlation of profiles, and its lead over the second best
LARGEST_WAVE_PX = 1.2  # standard deviation of the shift along a pair of segments


@dataclass(frozen=True)
class Segments:
    """Edge segments of one image.

    Attributes
    ----------
    columns : float32 (N, H)
        Column of every segment in every row, NaN where it does not reach.
    kinds : int (N,)
        Sign of contrast and direction, 0 to 5; only equal kinds correspond.
    profiles : float32 (N, 2 REACH_PX + 1)
        Locally normalised intensity across the edge, averaged along it, of mean 0 and length 1.
    """

    columns: Floats
    kinds: NDArray[np.int64]
    profiles: Floats


def find_segments(gray: Gray) -> Segments:
    """Return the longest steep edge segments of a gray image (H, W).

    Edges are found by Canny's detector with limits that follow the image's own gradients, cut where their direction or
    sign of contrast changes, and kept from 6 rows on.
    """
    soft = cv2.GaussianBlur(gray, (0, 0), 1.0)
    dx, dy = (cv2.Sobel(soft, cv2.CV_16S, *order) for order in ((1, 0), (0, 1)))
    strong = float(np.quantile(np.abs(dx[::2, ::2]), 1 - EDGE_SHARE))
    edge = cv2.Canny(dx, dy, 0.4 * max(strong, 2.0), max(strong, 4.0), L2gradient=True) > 0
    edge &= np.abs(dy) <= STEEPEST * np.abs(dx)
    slope = dy / np.where(dx == 0, 1, dx)
    kind = np.digitize(slope, SLOPES) + 3 * (dx > 0)
    height = gray.shape[0]
    columns, kinds = [np.zeros((0, height), np.float32)], [np.zeros(0, np.int64)]
    for number in range(6):
        traced = _trace(edge & (kind == number))
        columns.append(traced)
        kinds.append(np.full(len(traced), number))
    every, kind_of = np.concatenate(columns), np.concatenate(kinds)
    longest = np.argsort(-np.isfinite(every).sum(axis=1), kind="stable")[:LARGEST_COUNT]
    return Segments(every[longest], kind_of[longest], _profiles(gray, every[longest]))


def _trace(mask: NDArray[np.bool_]) -> Floats:
    """Return the mean column per row of every connected component that is long enough, (N, H)."""
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    height = mask.shape[0]
    y, x = np.nonzero(mask)
    place = labels[y, x].astype(np.int64) * height + y
    members = np.bincount(place, minlength=count * height).reshape(count, height)
    sums = np.bincount(place, weights=x, minlength=count * height).reshape(count, height)
    long = np.flatnonzero((members > 0).sum(axis=1) >= LEAST_ROWS)
    with np.errstate(invalid="ignore"):
        return np.asarray(sums[long] / members[long], dtype=np.float32)


def _profiles(gray: Gray, columns: Floats) -> Floats:
    normal = normalise_contrast(gray, 5.0, DAMPING_DN)
    offsets = np.arange(-REACH_PX, REACH_PX + 1)
    profiles = sample_beside(normal, columns, offsets)
    profiles -= profiles.mean(axis=1, keepdims=True)
    length = np.sqrt((profiles**2).sum(axis=1, keepdims=True))
    return np.asarray(profiles / np.maximum(length, 1e-6), dtype=np.float32)


def sample_beside(image: Floats, columns: Floats, offsets: NDArray[np.int64]) -> Floats:
    """Return the mean of an image (H, W) along each segment, `offsets` columns beside it, (N, len(offsets))."""
    segment, row = np.nonzero(np.isfinite(columns))
    column = np.rint(columns[segment, row]).astype(int)[:, None] + offsets
    values = image[row[:, None], np.clip(column, 0, image.shape[1] - 1)]
    count = np.maximum(np.bincount(segment, minlength=len(columns)), 1)[:, None]
    sums = [np.bincount(segment, weights=values[:, i], minlength=len(columns)) for i in range(len(offsets))]
    return np.asarray(np.stack(sums, axis=1) / count, dtype=np.float32)


def match_segments(left: Segments, right: Segments, first_px: float, last_px: float) -> NDArray[np.int64]:
    """Return the corresponding segments of two images, (M, 2) indices.

    Segments correspond when they share most of their rows, sign of contrast and direction, run in parallel at a
    disparity within the limits, and each one's profile is the most alike to the other's.
    """
    pairs = []
    for kind in range(6):
        ours, theirs = (np.flatnonzero(side.kinds == kind) for side in (left, right))
        if not len(ours) or not len(theirs):
            continue
        likeness = _likeness(left, right, ours, theirs, first_px, last_px)
        best, back = likeness.argmax(axis=1), likeness.argmax(axis=0)
        ranked = np.sort(likeness, axis=1)
        second = ranked[:, -2] if likeness.shape[1] > 1 else np.full(len(ours), -1.0)
        top = ranked[:, -1]
        good = (top >= LEAST_LIKENESS) & (top - second >= LEAST_LEAD) & (back[best] == np.arange(len(ours)))
        pairs.append(np.stack([ours[good], theirs[best[good]]], axis=1))
    return np.concatenate(pairs) if pairs else np.zeros((0, 2), np.int64)


def _likeness(
    left: Segments,
    right: Segments,
    ours: NDArray[np.int64],
    theirs: NDArray[np.int64],
    first_px: float,
    last_px: float,
) -> Floats:
    """Return the correlation of profiles for every pair, -1 where geometry forbids it."""
    a, b = left.columns[ours], right.columns[theirs]
    a_known, b_known = np.isfinite(a), np.isfinite(b)
    a_rows, b_rows = a_known.astype(np.float32), b_known.astype(np.float32)
    shared = a_rows @ b_rows.T
    # Sums over the shared rows, as products of matrices: mean and spread of the shift of every pair at once.
    a0, b0 = np.where(a_known, a, 0), np.where(b_known, b, 0)
    total = np.maximum(shared, 1)
    mean = (a0 @ b_rows.T - a_rows @ b0.T) / total
    square = ((a0**2) @ b_rows.T - 2 * (a0 @ b0.T) + a_rows @ (b0**2).T) / total
    wave = np.sqrt(np.maximum(square - mean**2, 0))
    shorter = np.minimum(a_rows.sum(axis=1)[:, None], b_rows.sum(axis=1)[None, :])
    possible = (shared >= np.maximum(0.6 * shorter, LEAST_ROWS - 1)) & (wave <= LARGEST_WAVE_PX)
    possible &= (mean >= first_px) & (mean <= last_px)
    return np.where(possible, left.profiles[ours] @ right.profiles[theirs].T, np.float32(-1))
