"""`too-long`: a list is longer than it may be."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "too-long",
    "error",
    "A list is longer than it may be.",
    "`sub` and `div` take two operands and `clamp` three; what the others were for cannot be guessed.",
    "Nest calculations.",
)
