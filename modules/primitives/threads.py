"""How many threads an operator may use."""

from __future__ import annotations

import cv2


def allowed_threads(most: int) -> int:
    """Return how many threads to use: at most `most`, and no more than the process gives OpenCV.

    One limit holds for all operators of a process, `cv2.setNumThreads`, which programs that use OpenCV set already; a
    worker of a batch sets it for itself. Results do not depend on it.

    Examples
    --------
    >>> allowed_threads(1)
    1
    """
    return max(1, min(most, cv2.getNumThreads()))
