"""`key-not-text`: a key is not plain text."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "key-not-text",
    "error",
    "A key is not plain text.",
    "It cannot be a name of the language.",
    "Write a name, and quote it where it has odd characters.",
)
