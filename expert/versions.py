"""Versions of what a decision depends on."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

PACKAGES = ("terrex", "experta", "numpy", "opencv-python-headless", "numba")


def versions() -> dict[str, str]:
    """Return the version of Python and of the packages that products depend on."""
    return {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}}


@cache
def _version(package: str) -> str:
    """Return an installed version; what is imported stays the same while a process lives."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
