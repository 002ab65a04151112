"""The error of wrong usage."""

from __future__ import annotations


class UsageError(Exception):
    """Wrong usage; exit code 2."""
