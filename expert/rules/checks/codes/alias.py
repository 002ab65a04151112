"""`alias`: a YAML alias (`*name`) is used."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "alias",
    "error",
    "A YAML alias (`*name`) is used.",
    "Aliases can blow a small file up to gigabytes, and hide from the reader what a rule says.",
    "Write the value out; numbers that several rules share are named thresholds.",
)
