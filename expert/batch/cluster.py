"""Workers on other machines: a Dask cluster that somebody else has started."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from expert.batch.item import BatchItem
from expert.batch.local import in_worker, in_worker_packed
from expert.batch.work import Outcome, Settings, inputs_digest, pack, stamp, unpack, unprocessed
from modules.formats.atomic import whole_folder
from modules.formats.errors import FormatError

if TYPE_CHECKING:
    from distributed import Future

Transfer = Literal["path", "bytes"]
AHEAD = 2  # pairs sent ahead per thread of the cluster
POLL_S = 0.02
RETRIES = 3  # times a pair is tried again when its worker is lost


def run_on_cluster(
    items: Iterator[tuple[BatchItem, Path]],
    settings: Settings,
    address: str,
    transfer: Transfer,
    stopping: Callable[[], bool],
) -> Iterator[tuple[BatchItem, Outcome]]:
    """Process items on a Dask cluster and yield them as they end, in whatever order.

    Parameters
    ----------
    items : iterator of (BatchItem, Path)
        Pairs and the folders of their products.
    settings : Settings
    address : str
        Of the scheduler, e.g. `tcp://host:8786`.
    transfer : {"path", "bytes"}
        Whether the workers read and write the same paths as this process, or get and return the contents.
    stopping : callable
        Asked before each pair is sent; True ends the batch after the pairs in work.

    Raises
    ------
    FormatError
        The extra `distributed` is not installed, or the scheduler does not answer.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise FormatError("--scheduler needs the extra 'distributed': pip install 'terrex[distributed]'") from error
    try:
        client = Client(address, timeout="20s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise FormatError(
            f"the scheduler at {address} does not answer ({error}); start it with `dask scheduler`"
        ) from error
    pending: dict[Future, tuple[BatchItem, Path]] = {}
    with client:
        more = True
        while more or pending:
            room = max(sum(client.nthreads().values()), 1) * AHEAD
            while more and not stopping() and len(pending) < room:
                taken = next(items, None)
                if taken is None:
                    more = False
                    break
                try:
                    pending[_send(client, taken, settings, transfer)] = taken
                except OSError as error:
                    yield taken[0], unprocessed(taken[0], "unreadable", str(error))
            if stopping():
                more = False
            for future in _ended(list(pending)):
                item, out = pending.pop(future)
                yield item, _fetch(future, item, out)


def _send(client, taken: tuple[BatchItem, Path], settings: Settings, transfer: Transfer) -> Future:  # type: ignore[no-untyped-def]
    item, out = taken
    if transfer == "path":
        return client.submit(in_worker, item, out, settings, pure=False, retries=RETRIES)
    return client.submit(in_worker_packed, pack(item), settings, pure=False, retries=RETRIES)


def _ended(futures: list[Future]) -> list[Future]:
    """Return the futures that have ended, well or not; wait a moment where none has."""
    done = [future for future in futures if future.done()]
    if not done:
        time.sleep(POLL_S)
    return done


def _fetch(future: Future, item: BatchItem, out: Path) -> Outcome:
    """Take the outcome of a future, and write its products where they came as bytes."""
    failed = future.exception()
    if failed is not None:
        return unprocessed(item, "crashed", f"no worker ended the pair: {type(failed).__name__}: {failed}")
    outcome: Outcome = future.result()
    if outcome.products is None:
        return outcome
    try:
        with whole_folder(out) as folder:
            unpack(outcome.products, folder)
    except (FormatError, OSError) as error:
        return unprocessed(item, "error", str(error))
    return replace(outcome, products=None, inputs=inputs_digest(item), stamp=stamp(item))
