"""Inference engines: a rule base and facts in, firings out."""

from __future__ import annotations

from typing import Literal

from expert.facts import Vocabulary, vocabulary
from expert.firing import Engine

EngineName = Literal["experta", "compiled"]
ENGINES: tuple[EngineName, ...] = ("experta", "compiled")


def any_engine() -> Engine:
    """Return a new engine for the shipped vocabulary; which one says nothing about the result, so the fast one."""
    from modules.catalog import probes

    return make_engine("compiled", vocabulary(probes().values()))


def make_engine(name: EngineName, vocabulary: Vocabulary) -> Engine:
    """Return a new engine; what it depends on is imported only now.

    Parameters
    ----------
    name : {"experta", "compiled"}
        `experta` is a RETE network, `compiled` closures without any dependency; they agree on every result.
    vocabulary : mapping of str to TemplateInfo
        Templates that rules may speak of.

    Raises
    ------
    ValueError
        There is no engine of that name.
    """
    if name == "experta":
        from expert.engine.experta_engine import ExpertaEngine

        return ExpertaEngine(vocabulary)
    if name == "compiled":
        from expert.engine.compiled import CompiledEngine

        return CompiledEngine(vocabulary)
    raise ValueError(f"unknown engine {name!r}; choose one of {', '.join(ENGINES)}")
