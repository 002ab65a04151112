"""`wrong-version`: the file is written for another version of the language."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "wrong-version",
    "error",
    "The file is written for another version of the language.",
    "It may mean something else.",
    "Write `version: 1`, after a look at what changed.",
)
