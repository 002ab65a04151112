"""`not-utf8`: a file is not UTF-8."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "not-utf8",
    "error",
    "A file is not UTF-8.",
    "Its characters would be guessed, and differently on another machine.",
    "Save the file as UTF-8.",
)
