"""`duplicate-id`: an id or a slot is used twice in one file."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "duplicate-id",
    "error",
    "An id or a slot is used twice in one file.",
    "The second would replace the first without a word.",
    "Give it an id of its own; `terrex rules new` proposes a free one.",
)
