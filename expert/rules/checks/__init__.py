"""Checks of a rule base: references must be sound for it to load; warnings are for its author."""

from __future__ import annotations

from expert.rules.checks.references import reference_problems

__all__ = ["reference_problems"]
