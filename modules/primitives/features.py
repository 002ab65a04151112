"""Sparse matches between the images of a pair."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.types import Correspondences

LOWE_RATIO = 0.8  # D. Lowe, IJCV 2004, section 7.1


def stretch(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Stretch the 1st to 99th percentile of a gray image to 0-255, so that dark images give as many features."""
    low, high = np.percentile(image[::4, ::4], (1, 99))
    gain = 255.0 / max(high - low, 16.0)
    table = np.clip((np.arange(256) - low) * gain, 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(image, table), dtype=np.uint8).reshape(image.shape)


def match_features(
    left: NDArray[np.uint8], right: NDArray[np.uint8], limit: int = 2000
) -> tuple[Correspondences, tuple[int, int]]:
    """Match SIFT features by nearest descriptor, ratio test and mutual agreement.

    Parameters
    ----------
    left, right : uint8 (H, W)
    limit : int
        Features kept per image.

    Returns
    -------
    matches : Correspondences
        Sorted by row and column; not checked against any geometry.
    found : (int, int)
        Number of features found in the left and the right image.

    References
    ----------
    D. Lowe, Distinctive image features from scale-invariant keypoints, IJCV 2004.
    """
    none = np.zeros((0, 2), np.float32)
    if min(left.shape) < 16:
        return Correspondences(none, none), (0, 0)
    detector = cv2.SIFT.create(nfeatures=limit, contrastThreshold=0.02)
    found, points, descriptors = [], [], []
    for image in (left, right):
        keypoints, descriptor = detector.detectAndCompute(stretch(image), None)
        found.append(len(keypoints))
        points.append(np.array([point.pt for point in keypoints], np.float32).reshape(-1, 2))
        descriptors.append(descriptor)
    if min(found) < 2:
        return Correspondences(none, none), (found[0], found[1])
    forward, backward = _nearest(descriptors[0], descriptors[1]), _nearest(descriptors[1], descriptors[0])
    pairs = sorted({(i, j) for i, j in forward.items() if backward.get(j) == i})
    if not pairs:
        return Correspondences(none, none), (found[0], found[1])
    index = np.array(pairs)
    left_xy, right_xy = points[0][index[:, 0]], points[1][index[:, 1]]
    _, unique = np.unique(np.hstack([left_xy, right_xy]), axis=0, return_index=True)
    left_xy, right_xy = left_xy[unique], right_xy[unique]
    order = np.lexsort((left_xy[:, 0], left_xy[:, 1]))
    return Correspondences(left_xy[order], right_xy[order]), (found[0], found[1])


def _nearest(queries: Any, train: Any) -> dict[int, int]:
    result: dict[int, int] = {}
    for candidates in cv2.BFMatcher(cv2.NORM_L2).knnMatch(queries, train, k=2):
        if len(candidates) == 2 and candidates[0].distance < LOWE_RATIO * candidates[1].distance:
            result[candidates[0].queryIdx] = candidates[0].trainIdx
    return result
