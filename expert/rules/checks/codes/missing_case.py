"""`missing-case`: a rule that nothing proves."""

from __future__ import annotations

from collections.abc import Iterator

from expert.rules.checks.check import Check
from expert.rules.checks.context import Context
from expert.rules.margin import Judge, has_boundary
from expert.rules.problem import Problem


def _find(context: Context) -> Iterator[Problem]:
    if context.cases is None:
        return
    base = context.merged.base()
    for rule, origin in context.merged.rules.values():
        cases = context.cases.get(rule.id, ())
        missing = [] if any(case.fires for case in cases) else ["where it fires"]
        missing += [] if any(not case.fires for case in cases) else ["where it stays quiet"]
        if has_boundary(rule, context.vocabulary) and not any(
            Judge(base, context.vocabulary, case.facts).at_boundary(rule) for case in cases
        ):
            missing.append("at a threshold")
        if missing:
            message = f"rule {rule.id} has no case {', none '.join(missing)}"
            folder = context.case_folder or "FOLDER"
            hint = f"add it to {folder}/{rule.id}.yaml" + ("" if context.case_folder else " and give --cases FOLDER")
            yield origin.problem((), "missing-case", message, hint)


CHECK = Check(
    "missing-case",
    "warning",
    "A rule has no case where it fires, none where it stays quiet, or none at a threshold.",
    "A rule without cases may be wrong for years; one whose limits no case touches changes unseen.",
    "Add the case; `terrex rules test ID --missing` writes those at the thresholds.",
    _find,
)
