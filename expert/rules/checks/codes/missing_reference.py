"""`missing-reference`: a rule names no source."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "missing-reference",
    "error",
    "A rule names no source.",
    "Whoever doubts it has nowhere to look.",
    "Name a paper, or a script that anyone can run, under `references`.",
)
