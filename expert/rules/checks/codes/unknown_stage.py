"""`unknown-stage`: a section of `slots` is no stage."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "unknown-stage",
    "error",
    "A section of `slots` is no stage.",
    "Its slots would belong to no plan.",
    "Write measurement, correction, matching or reconstruction.",
)
