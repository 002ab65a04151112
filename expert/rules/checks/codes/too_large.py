"""`too-large`: a file is larger than 4 MB."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "too-large",
    "error",
    "A file is larger than 4 MB.",
    "No rule file written by people is; reading it would cost time and memory without end.",
    "Split it into layers.",
)
