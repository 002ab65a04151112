"""How much more two processes of this machine do than one: the most that two workers can gain."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Sequence
from multiprocessing.synchronize import Barrier

import cv2

from benchmarks.batch_pairs import QUIET
from expert import StereoPair
from expert.batch import BatchItem
from modules.primitives.threads import serial_linear_algebra

ROUNDS = 20_000_000


def ceiling(items: Sequence[BatchItem]) -> tuple[float, float]:
    """Return how many times as much two processes do as one: of a plain loop, and of reconstructions."""
    found = []
    for task in (None, tuple(items)):
        one, two = (_slowest(count, task) for count in (1, 2))
        found.append(2 * one / two)
    return found[0], found[1]


def _slowest(count: int, task: tuple[BatchItem, ...] | None) -> float:
    """Do a task in so many processes at once; return the seconds of the slowest."""
    context = multiprocessing.get_context("spawn")
    start, ends = context.Barrier(count), context.SimpleQueue()
    workers = [context.Process(target=_work, args=(start, ends, task)) for _ in range(count)]
    with serial_linear_algebra():
        for worker in workers:
            worker.start()
    spent = [ends.get() for _ in workers]
    for worker in workers:
        worker.join()
    return max(spent)


def _work(start: Barrier, ends: multiprocessing.SimpleQueue[float], task: tuple[BatchItem, ...] | None) -> None:
    act = _plain if task is None else _bare(task)
    start.wait()
    begun = time.perf_counter()
    act()
    ends.put(time.perf_counter() - begun)


def _plain() -> None:
    total = 0
    for number in range(ROUNDS):
        total ^= number


def _bare(items: Sequence[BatchItem]) -> Callable[[], None]:
    """Return what reconstructs pairs and keeps nothing; everything is loaded and warm."""
    cv2.setNumThreads(1)
    system = QUIET.system()
    loaded = [StereoPair.load(item.left, item.right, calibration=item.stated.calibration) for item in items]
    system.reconstruct(loaded[0])

    def act() -> None:
        for pair in loaded:
            system.reconstruct(pair)

    return act
