"""terrex: a rule-based expert system that reconstructs 3D terrain from stereo pairs and explains every decision."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from expert.api import ExpertSystem
    from expert.decision import Decision
    from expert.pair import PairError, StereoPair
    from expert.result import Result

__all__ = ["Decision", "ExpertSystem", "PairError", "Result", "StereoPair"]

_HOMES = {
    "Decision": "expert.decision",
    "ExpertSystem": "expert.api",
    "PairError": "expert.pair",
    "Result": "expert.result",
    "StereoPair": "expert.pair",
}


def __getattr__(name: str) -> object:
    """Import what is asked for; a command that needs little starts fast."""
    if name not in _HOMES:
        raise AttributeError(f"module 'expert' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
