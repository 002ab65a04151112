"""What a check is: a code, what it reports and why, what to do about it, and the function that looks for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from expert.rules.checks.context import Context
from expert.rules.problem import Level, Problem

Finder = Callable[[Context], Iterable[Problem]]


@dataclass(frozen=True)
class Check:
    """One entry of the catalog of checks.

    Attributes
    ----------
    code : str
        As it stands in a message, e.g. `unknown-fact`.
    level : {"error", "warning", "note"}
        An error keeps the rules from loading; a warning is for their author and can be silenced; a note is no fault.
    reports : str
        What it reports, one sentence.
    why : str
        What goes wrong if nobody looks.
    remedy : str
        What to do about it.
    find : callable, optional
        Looks for it in a whole rule base; None where the fault is found while the file is read.
    """

    code: str
    level: Level
    reports: str
    why: str
    remedy: str
    find: Finder | None = None
