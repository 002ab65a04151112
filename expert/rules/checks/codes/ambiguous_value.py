"""`ambiguous-value`: a plain value is read differently by different YAML readers."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "ambiguous-value",
    "error",
    "A plain value is read differently by different YAML readers: yes, no, 1:30, 0x1f, 2014-01-01.",
    "What was meant as text becomes true, a number or a date, or the other way round.",
    "Write true, false or a finite decimal number, or quote the text.",
)
