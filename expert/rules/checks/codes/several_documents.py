"""`several-documents`: a file holds more than one YAML document."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "several-documents",
    "error",
    "A file holds more than one YAML document.",
    "Only the first one would be read, without a word about the others.",
    "Remove the `---` between them.",
)
