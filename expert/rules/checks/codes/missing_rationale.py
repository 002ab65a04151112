"""`missing-rationale`: a rule does not say why it is right."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "missing-rationale",
    "error",
    "A rule does not say why it is right.",
    "A rule whose reason nobody knows can be neither trusted nor changed.",
    "Write `because:` in words an engineer accepts, with the measured figure.",
)
