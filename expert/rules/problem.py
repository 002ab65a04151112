"""What is wrong with a rule file: where, what, and what to do about it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Literal

MAX_TEXT = 1000  # characters of a message, which may quote what a file holds


def printable(text: str) -> str:
    r"""Return a text as it may be shown on a terminal: control and direction characters escaped, not endless.

    Examples
    --------
    >>> print(printable("a\tb"))
    a\tb
    """
    if not text.isprintable():
        text = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)
    return text if len(text) <= MAX_TEXT else text[: MAX_TEXT - 3] + "..."


Level = Literal["error", "warning", "note"]


@dataclass(frozen=True, order=True)
class Problem:
    """One problem at one place of a file; line and column count from 1. Texts are made printable."""

    file: str
    line: int
    column: int
    code: str
    message: str
    hint: str = ""
    level: Level = "error"

    def __post_init__(self) -> None:
        for name in ("message", "hint"):
            object.__setattr__(self, name, printable(getattr(self, name)))

    def __str__(self) -> str:
        """Write it as `file:line:column: code: message; hint`; a note says that it is one."""
        tail = f"; {self.hint}" if self.hint else ""
        note = "note: " if self.level == "note" else ""
        return f"{self.file}:{self.line}:{self.column}: {note}{self.code}: {self.message}{tail}"

    def as_dict(self) -> dict[str, str | int]:
        """Return it as plain data for JSON."""
        return asdict(self)


class RuleFileError(ValueError):
    """Rule files that cannot be used; carries every problem found, not only the first."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems: tuple[Problem, ...] = tuple(sorted(set(problems)))
        super().__init__("\n".join(str(problem) for problem in self.problems))


def suggest(word: str, known: Iterable[str]) -> str:
    """Return a hint that names the nearest known word, or the few there are."""
    options: Sequence[str] = sorted(known)
    near = difflib.get_close_matches(word, options, n=1, cutoff=0.6)
    if near:
        return f"did you mean '{near[0]}'?"
    if 0 < len(options) <= 12:
        return f"known: {', '.join(options)}"
    return ""
