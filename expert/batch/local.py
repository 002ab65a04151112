"""Workers on this machine: processes started by `spawn`, with a limit on time and memory for each pair."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, TimeoutError, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from multiprocessing import resource_tracker
from pathlib import Path

import cv2
from pebble import ProcessExpired, ProcessPool

from expert.api import ExpertSystem
from expert.batch.item import BatchItem
from expert.batch.work import Outcome, Packed, Settings, process, process_packed, unprocessed
from modules.primitives.threads import serial_linear_algebra

AHEAD = 1  # pairs that wait beside those in work, so that no worker is idle


@dataclass(frozen=True)
class Limits:
    """Limits of one worker.

    Attributes
    ----------
    timeout_s : float or None
        A pair that takes longer is given up and its worker replaced.
    memory_mb : int or None
        Data a worker may hold beyond what it starts with, MB; Linux and macOS.
    threads : int or None
        Threads a worker uses; None for as many as there are processors.
    """

    timeout_s: float | None = None
    memory_mb: int | None = None
    threads: int | None = 1


@cache
def _system(settings: Settings) -> ExpertSystem:
    """The expert system of this worker, built once."""
    return settings.system()


def start_worker(settings: Settings, limits: Limits) -> None:
    """Prepare a worker process: it leaves interrupts to its parent, keeps its limits, and builds the expert system."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if limits.threads is not None:
        cv2.setNumThreads(limits.threads)
    _system(settings)
    if limits.memory_mb is not None:
        _limit_memory(limits.memory_mb)


def _limit_memory(memory_mb: int) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    held = 0
    if os.path.exists("/proc/self/statm"):
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
        held = pages * resource.getpagesize()
    limit = held + memory_mb * 1_000_000
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def in_worker(item: BatchItem, out: Path, settings: Settings) -> Outcome:
    """Process one pair; runs in a worker."""
    return process(_system(settings), item, out, settings)


def in_worker_packed(packed: Packed, settings: Settings) -> Outcome:
    """Process one pair that came with its files; runs in a worker that does not share a disk."""
    return process_packed(_system(settings), packed, settings)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block SIGINT for the processes and threads that are started here, and for what those start.

    A terminal sends it to the workers, too, and they would end with a traceback while they still import.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # what starts it, as the first worker would, unblocks SIGINT again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def run_here(
    items: Iterator[tuple[BatchItem, Path]], settings: Settings, limits: Limits, jobs: int, stopping: Callable[[], bool]
) -> Iterator[tuple[BatchItem, Outcome]]:
    """Process items in worker processes and yield them as they end, in whatever order.

    Parameters
    ----------
    items : iterator of (BatchItem, Path)
        Pairs and the folders of their products; taken one by one as workers become free.
    settings, limits
    jobs : int
        Worker processes.
    stopping : callable
        Asked before each pair begins; True ends the batch after the pairs in work.
    """
    context = multiprocessing.get_context("spawn")
    with serial_linear_algebra():
        pool = ProcessPool(max_workers=jobs, context=context, initializer=start_worker, initargs=(settings, limits))
        pending: dict[Future[Outcome], BatchItem] = {}
        try:
            more = True
            while more or pending:
                while more and not stopping() and len(pending) < jobs + AHEAD:
                    taken = next(items, None)
                    if taken is None:
                        more = False
                        break
                    with _without_interrupts():  # the first call starts the workers
                        scheduled = pool.schedule(in_worker, args=(*taken, settings), timeout=limits.timeout_s)
                    pending[scheduled] = taken[0]
                if stopping():
                    more = False
                    for future in list(pending):
                        if not future.running() and future.cancel():
                            del pending[future]
                done, _ = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
                for future in done:
                    item = pending.pop(future)
                    outcome = _outcome(future, item, limits)
                    if outcome is not None:
                        yield item, outcome
            if stopping():
                pool.stop()  # every worker is idle, or still starting for a pair that was called off
            else:
                pool.close()
        except BaseException:
            pool.stop()
            raise
        finally:
            pool.join()


def _outcome(future: Future[Outcome], item: BatchItem, limits: Limits) -> Outcome | None:
    """Return what a future holds; a worker that died or was stopped tells nothing of its own."""
    try:
        return future.result()
    except CancelledError:
        return None
    except TimeoutError:
        reason = f"took longer than the limit of {limits.timeout_s:g} s; raise --timeout"
        return unprocessed(item, "timeout", reason, limits.timeout_s or 0.0)
    except ProcessExpired as error:
        reason = f"the worker process died (exit code {error.exitcode}); a native library crashed or memory ran out"
        return unprocessed(item, "crashed", reason)
    except Exception as error:  # noqa: BLE001  whatever a worker could not tell by itself belongs to its pair
        return unprocessed(item, "error", f"{type(error).__name__}: {error}")
