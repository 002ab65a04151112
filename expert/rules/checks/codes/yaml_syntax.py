"""`yaml-syntax`: a file is not YAML."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "yaml-syntax",
    "error",
    "A file is not YAML.",
    "Where one bracket or quote is wrong, nothing after it can be trusted.",
    "Look at the place and just above it: indentation, brackets, quotes, tabs.",
)
