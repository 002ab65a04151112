"""`tag`: a YAML tag (`!name`) is used."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "tag",
    "error",
    "A YAML tag (`!name`) is used.",
    "Tags construct objects in some readers; a rule file is plain data.",
    "Remove the tag.",
)
