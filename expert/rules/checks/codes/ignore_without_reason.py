"""`ignore-without-reason`: a comment silences a warning without a reason."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "ignore-without-reason",
    "warning",
    "A comment silences a warning without a reason.",
    "In a year nobody knows whether it still holds.",
    "Write the reason behind it: `# terrex: ignore[code] reason`.",
)
