"""`unknown-rule`: a file disables a rule that no lower layer has, or a case file belongs to no rule."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "unknown-rule",
    "error",
    "A file disables a rule that no lower layer has, or a case file belongs to no rule.",
    "The rule that was meant is still in force.",
    "Write the id that is suggested.",
)
