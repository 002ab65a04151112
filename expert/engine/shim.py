"""What has to be true while the RETE library is imported, and only then."""

from __future__ import annotations

import collections
import collections.abc
import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def importable() -> Iterator[None]:
    """Make the import possible and leave no trace of it.

    Its dependency `frozendict` looks for `collections.Mapping`, which Python 3.10 removed, and the library calls
    `logging.basicConfig`, which would take the configuration of logging away from the program.
    """
    missing = not hasattr(collections, "Mapping")
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    if missing:
        collections.Mapping = collections.abc.Mapping  # type: ignore[attr-defined]
    try:
        yield
    finally:
        if missing:
            del collections.Mapping  # type: ignore[attr-defined]
        for handler in [handler for handler in root.handlers if handler not in handlers]:
            root.removeHandler(handler)
            handler.close()
        root.setLevel(level)
