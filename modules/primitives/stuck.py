"""Pixels and lines of a sensor that do not answer to light as their neighbours do."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.types import Mask

Gray = NDArray[np.uint8]

RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
CLIPPED_DN = 250  # lossy compression blurs 255; beside clipped pixels nothing can be said of a pixel
STEP_DN = 8  # a line differs by this from the mean of its neighbours ...
ONE_SIDED = 0.93  # ... with one sign on nearly its whole length, which edges of a scene seldom do
ENOUGH_ROWS = 240  # of a column tell whether it stands out
FEW_ROWS = 4  # every so many rows are looked at first
LEAST_ROWS = 24  # that are not clipped, or nothing is said of the column
LEAST_ROWS_SHARE = 0.1


def find_columns(gray: Gray) -> NDArray[np.int64]:
    """Return the columns that are brighter, or darker, than both of their neighbours on nearly their whole length.

    Parameters
    ----------
    gray : uint8 (H, W)
        Pass the transpose to find rows.

    Returns
    -------
    int64 (N,)
        Increasing. Of neighbouring columns, which stand out from each other, the strongest.
    """
    if gray.shape[1] < 3:
        return np.zeros(0, np.int64)
    values = gray[:: max(1, gray.shape[0] // ENOUGH_ROWS)]
    # Few rows that disagree rule a column out, and mostly they rule out all.
    counts = _compare(values[::FEW_ROWS]).counts
    against = counts[2] - np.maximum(counts[0], counts[1])
    if not (against[1:-1] < (1 - ONE_SIDED) * len(values)).any():
        return np.zeros(0, np.int64)
    compared = _compare(values)
    counts = compared.counts
    enough = counts[2] >= max(LEAST_ROWS, LEAST_ROWS_SHARE * len(values))
    found = enough & (np.abs(counts[0] - counts[1]) > ONE_SIDED * counts[2])
    found[[0, -1]] = False
    if not found.any():
        return np.zeros(0, np.int64)
    strength = np.zeros(len(found))
    strength[found] = np.abs(compared.twice_dn[:, found] * compared.usable[:, found]).sum(axis=0)
    strongest = (strength[1:-1] > strength[:-2]) & (strength[1:-1] >= strength[2:])
    return np.flatnonzero(strongest) + 1


@dataclass(frozen=True)
class _Compared:
    """Pixels against the mean of their neighbours left and right.

    Attributes
    ----------
    twice_dn : int16 (H, W)
        Twice the difference from that mean.
    usable : bool (H, W)
        Neither the pixel nor one of the two is clipped.
    counts : three int32 (W,)
        Usable pixels of each column that are clearly brighter, clearly darker, and all of them.
    """

    twice_dn: NDArray[np.int16]
    usable: Mask
    counts: list[NDArray[np.int32]]


def _compare(rows: Gray) -> _Compared:
    values = np.ascontiguousarray(rows)
    twice = np.asarray(cv2.sepFilter2D(values, cv2.CV_16S, np.array([-1.0, 2.0, -1.0]), np.ones(1)), np.int16)
    usable = cv2.dilate(values, np.ones((1, 3), np.uint8)) < CLIPPED_DN
    signs = (twice > 2 * STEP_DN) & usable, (twice < -2 * STEP_DN) & usable
    return _Compared(twice, usable, [_column_sums(sign) for sign in (*signs, usable)])


def _column_sums(marked: Mask) -> NDArray[np.int32]:
    return np.asarray(cv2.reduce(marked.view(np.uint8), 0, cv2.REDUCE_SUM, dtype=cv2.CV_32S), np.int32).ravel()


@dataclass(frozen=True)
class StandingOut:
    """How each pixel of a plane lies to its eight neighbours, each uint8 or bool (H, W).

    Attributes
    ----------
    beyond_dn
        Distance from the range of the neighbours; 0 within it, and where not usable.
    spread_dn
        Width of that range.
    usable
        Whether no neighbour is clipped; a pixel that is clipped alone is usable.
    """

    beyond_dn: Gray
    spread_dn: Gray
    usable: Mask


def stand_out(plane: Gray) -> StandingOut:
    """Compare each pixel of a plane, uint8 (H, W), with the range of its neighbours."""
    brightest, darkest = cv2.dilate(plane, RING), cv2.erode(plane, RING)
    beyond = np.asarray(cv2.max(cv2.subtract(plane, brightest), cv2.subtract(darkest, plane)), np.uint8)
    usable = np.asarray(brightest < CLIPPED_DN)
    beyond *= usable
    return StandingOut(beyond, np.asarray(cv2.subtract(brightest, darkest), np.uint8), usable)
