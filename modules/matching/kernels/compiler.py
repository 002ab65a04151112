"""How every kernel is compiled."""

from __future__ import annotations

from typing import Any

import numba

kernel: Any = numba.njit(cache=True, nogil=True, boundscheck=False)
