"""`unknown-action`: an item of `then` is no action."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "unknown-action",
    "error",
    "An item of `then` is no action.",
    "Nothing would happen when the rule fires.",
    "Write one of derive, measure, choose, exclude, set, assess, adjust, repair.",
)
