"""`too-deep`: something is nested more than 40 levels deep."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "too-deep",
    "error",
    "Something is nested more than 40 levels deep.",
    "No rule needs that; such files exhaust readers.",
    "Flatten it.",
)
