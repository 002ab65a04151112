"""`not-finite`: a number is too large to be one."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "not-finite",
    "error",
    "A number is too large to be one.",
    "Comparisons with infinity are always true or never.",
    "Write a finite number.",
)
