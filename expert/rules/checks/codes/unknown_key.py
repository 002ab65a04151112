"""`unknown-key`: a key is not part of the language."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "unknown-key",
    "error",
    "A key is not part of the language.",
    "What it says would be ignored without a word.",
    "Write the key that is suggested, or remove it.",
)
