"""How every kernel is compiled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba

kernel: Any = numba.njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")
part: Any = numba.njit(
    nogil=True, boundscheck=False, error_model="numpy", forceinline=True
)  # of a kernel, compiled into it


def will_compile(function: Any) -> bool:
    """Return whether the first call of a kernel has to compile it: neither this process nor the cache has it."""
    if function.signatures:
        return False
    module, name = function.py_func.__module__.rsplit(".", 1)[-1], function.py_func.__qualname__
    return not any(Path(function.stats.cache_path).glob(f"{module}.{name}-*.nbi"))
