"""`unreadable`: a file cannot be read."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "unreadable",
    "error",
    "A file cannot be read.",
    "Nothing in it can be checked.",
    "Check the path and the rights of the file.",
)
