"""How many threads an operator may use, and a worker process altogether."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import cv2

BLAS_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


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


@contextmanager
def serial_linear_algebra() -> Iterator[None]:
    """Let processes that start inside run NumPy's linear algebra in one thread each.

    The systems solved here are small and gain nothing from threads, while idle threads of the BLAS library spin and
    take the processor from other workers. The library reads these variables when it is loaded, so they have to be set
    before a worker starts. What is set already stays.
    """
    unset = [name for name in BLAS_VARIABLES if name not in os.environ]
    os.environ.update(dict.fromkeys(unset, "1"))
    try:
        yield
    finally:
        for name in unset:
            os.environ.pop(name, None)
