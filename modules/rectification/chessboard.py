"""Find the inner corners of a chessboard in the images of a stereo pair."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.primitives.photometry import to_8_bit, to_gray
from modules.types import Image

MAX_SEARCH_PX = 1280  # larger images are searched at a reduced size first and refined at full size
SMALLEST_BOARD = (3, 3)  # inner corners


@dataclass(frozen=True)
class Chessboard:
    """A chessboard by its inner corners.

    Attributes
    ----------
    columns, rows : int
        Inner corners along the two sides, at least 3 each.
    square_m : float
        Side of a square, m.
    """

    columns: int
    rows: int
    square_m: float

    def points_m(self) -> NDArray[np.float32]:
        """Return the corners in the plane of the board, float32 (N, 3), row by row."""
        grid = np.mgrid[0 : self.rows, 0 : self.columns].astype(np.float32)
        points = np.zeros((self.rows * self.columns, 3), np.float32)
        points[:, 0], points[:, 1] = grid[1].ravel() * self.square_m, grid[0].ravel() * self.square_m
        return points


@dataclass(frozen=True)
class BoardView:
    """Corners of one board in both images, in one order.

    Attributes
    ----------
    name : str
    left_px, right_px : float32 (N, 2)
    """

    name: str
    left_px: NDArray[np.float32]
    right_px: NDArray[np.float32]


def find_corners(image: Image, board: Chessboard) -> NDArray[np.float32] | None:
    """Return the inner corners, float32 (N, 2) px, row by row, or None where the whole board is not seen.

    References
    ----------
    A. Duda and U. Frese, Accurate detection and localization of checkerboard corners for calibration, BMVC 2018.
    """
    gray = np.ascontiguousarray(to_8_bit(to_gray(image)))
    size = (board.columns, board.rows)
    found: Any
    ok, found = cv2.findChessboardCornersSB(gray, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY)
    if ok:
        return np.asarray(found, np.float32).reshape(-1, 2)
    factor = min(1.0, MAX_SEARCH_PX / max(gray.shape))
    small = gray if factor == 1.0 else cv2.resize(gray, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    ok, found = cv2.findChessboardCorners(np.asarray(small), size, flags=flags)
    if not ok:
        return None
    corners = (np.asarray(found, np.float32).reshape(-1, 1, 2) + 0.5) / factor - 0.5
    half = max(3, int(_spacing(corners.reshape(-1, 2), board) / 3))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    refined = cv2.cornerSubPix(gray, corners.astype(np.float32), (half, half), (-1, -1), criteria)
    return np.asarray(refined, np.float32).reshape(-1, 2)


def count_corners(images: Iterable[Image]) -> tuple[int, int] | None:
    """Return the inner corners that boards in the images have, the larger number first, or None.

    The number is not presumed: it is what most images show, and two at least. Parts of a board count as boards, too, so
    this is a hint about a wrong `Chessboard`, nothing to calibrate with.
    """
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
    votes: Counter[tuple[int, int]] = Counter()
    for image in images:
        gray = np.ascontiguousarray(to_8_bit(to_gray(image)))
        made: Any = cv2.findChessboardCornersSBWithMeta(gray, SMALLEST_BOARD, flags)
        if made[0]:
            rows, columns = sorted(made[2].shape[:2])
            votes[(columns, rows)] += 1
    if not votes:
        return None
    chosen, number = max(votes.items(), key=lambda item: (item[1], item[0]))
    return chosen if number >= 2 else None


def find_board(name: str, left: Image, right: Image, board: Chessboard) -> BoardView | None:
    """Return the corners of the board in both images, or None where one of them does not show all of it."""
    in_left, in_right = find_corners(left, board), find_corners(right, board)
    if in_left is None or in_right is None:
        return None
    if float((in_left[-1] - in_left[0]) @ (in_right[-1] - in_right[0])) < 0.0:
        in_right = in_right[::-1].copy()  # a board that looks the same upside down may be counted from its other end
    return BoardView(name, in_left, in_right)


def _spacing(corners: NDArray[np.float32], board: Chessboard) -> float:
    grid = corners.reshape(board.rows, board.columns, 2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2).min()
    return float(min(across, np.linalg.norm(np.diff(grid, axis=0), axis=2).min()))
