"""`unknown-value`: a word is none of those that may stand there, e.g. an operator of a comparison or a stage."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "unknown-value",
    "error",
    "A word is none of those that may stand there, e.g. an operator of a comparison or a stage.",
    "The language has no such word.",
    "Write one of those that the message names.",
)
