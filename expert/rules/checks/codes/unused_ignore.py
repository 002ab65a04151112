"""`unused-ignore`: a comment silences a warning that is not there."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "unused-ignore",
    "warning",
    "A comment silences a warning that is not there.",
    "It would hide the next one.",
    "Remove the comment.",
)
