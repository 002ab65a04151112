"""Versions of what a decision depends on."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

PACKAGES = ("terrex", "experta", "numpy", "opencv-python-headless", "numba")


def versions() -> dict[str, str]:
    """Return the version of Python and of the packages that products depend on."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
