"""The limit on threads is the one of OpenCV, and the matcher keeps it."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from modules.matching.semi_global_match import SemiGlobalMatchParams, semi_global_match
from modules.primitives.threads import BLAS_VARIABLES, allowed_threads, serial_linear_algebra
from modules.types import DisparityRange, Matching, Views


@pytest.fixture
def limit() -> Iterator[None]:
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


@pytest.mark.usefixtures("limit")
@pytest.mark.parametrize(("of_process", "most", "allowed"), [(1, 2, 1), (2, 2, 2), (2, 1, 1), (0, 2, 1)])
def test_the_smaller_of_both_limits_holds(of_process: int, most: int, allowed: int) -> None:
    cv2.setNumThreads(of_process)
    assert allowed_threads(most) == allowed


@pytest.mark.usefixtures("limit")
@pytest.mark.parametrize(("of_process", "started"), [(1, 0), (2, 2)])
def test_the_matcher_starts_threads_only_where_the_process_may(
    of_process: int, started: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str] = []
    start = threading.Thread.start

    def counted(thread: threading.Thread) -> None:
        begun.append(thread.name)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", counted)
    cv2.setNumThreads(of_process)
    image = np.random.default_rng(0).integers(0, 255, (40, 60), np.uint8)
    semi_global_match(Matching(Views(image, image), DisparityRange(0, 8)), SemiGlobalMatchParams())
    assert len(begun) == started


def test_linear_algebra_is_serial_inside_and_what_was_set_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, *others = BLAS_VARIABLES
    monkeypatch.setenv(kept, "3")
    for name in others:
        monkeypatch.delenv(name, raising=False)
    with serial_linear_algebra():
        assert os.environ[kept] == "3"
        assert [os.environ[name] for name in others] == ["1"] * len(others)
    assert os.environ[kept] == "3"
    assert not set(others) & set(os.environ)
