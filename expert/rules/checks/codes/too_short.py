"""`too-short`: a text or a list is too short."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "too-short",
    "error",
    "A text or a list is too short.",
    "An empty list of conditions would fire for every pair.",
    "Write what is missing.",
)
