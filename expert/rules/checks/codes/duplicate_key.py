"""`duplicate-key`: a key is written twice in one mapping."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "duplicate-key",
    "error",
    "A key is written twice in one mapping.",
    "YAML readers keep one of the two, and not all the same one.",
    "Remove one of them.",
)
