"""One bad and one good example of every code; they are read as data, by tests and by the reference pages."""

from __future__ import annotations

from pathlib import Path

EXAMPLES = Path(__file__).parent
OVER_SHIPPED = frozenset({"override", "reused-id"})  # examples that lie over the shipped rules; the others stand alone
