"""`wrong-pattern`: a name or an id does not look like one."""

from __future__ import annotations

from expert.rules.checks.check import Check

CHECK = Check(
    "wrong-pattern",
    "error",
    "A name or an id does not look like one.",
    "Ids sort and are counted; names stand in messages and pages.",
    "Ids are three capitals and three digits; names small letters, digits, hyphens; fields of facts `alias.field`.",
)
