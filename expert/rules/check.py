"""Check rule files: the errors that keep them from loading, and warnings for their author.

A comment `# terrex: ignore[code] reason`, on the line of a warning or alone on the line above, silences it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path as FilePath

from expert.facts import Vocabulary
from expert.rules.cases import CaseFile, facts_of, read_cases
from expert.rules.checks.context import Context
from expert.rules.checks.ties import tie_warnings
from expert.rules.checks.usage import formula_warnings, usage_warnings
from expert.rules.layers import Merged
from expert.rules.load import inspect_rules
from expert.rules.margin import Judge, has_boundary
from expert.rules.problem import Problem
from expert.rules.reader import Document
from modules.operator import Operator
from modules.probe import Probe

_IGNORE = re.compile(r"#\s*terrex:\s*ignore\[([a-z-]+)\][ \t]*(.*)$")


def _case_warnings(context: Context, files: Iterable[CaseFile]) -> list[Problem]:
    """Return rules without a firing case, a quiet one, or one at a threshold."""
    by_rule = {file.rule: [case for case, _ in file.cases] for file in files}
    base = context.merged.base()
    problems: list[Problem] = []
    for rule, origin in context.merged.rules.values():
        cases = by_rule.get(rule.id, [])
        missing = [] if any(case.fires for case in cases) else ["where it fires"]
        missing += [] if any(not case.fires for case in cases) else ["where it stays quiet"]
        if has_boundary(rule, context.vocabulary) and not any(
            Judge(base, context.vocabulary, facts_of(case)).at_boundary(rule) for case in cases
        ):
            missing.append("at a threshold")
        if missing:
            message = f"rule {rule.id} has no case {', none '.join(missing)}"
            problems.append(origin.problem((), "missing-case", message, f"add it to knowledge/cases/{rule.id}.yaml"))
    return problems


def _silence(warnings: Iterable[Problem], documents: Iterable[Document]) -> list[Problem]:
    """Leave out what comments silence; complain about comments without a reason or without an effect."""
    ignores: dict[tuple[str, int, str], tuple[int, int]] = {}
    kept: list[Problem] = []
    for document in documents:
        for number, line in enumerate(document.text.splitlines(), start=1):
            found = _IGNORE.search(line)
            if not found:
                continue
            if not found[2].strip():
                message = f"`ignore[{found[1]}]` gives no reason"
                kept.append(Problem(document.file, number, found.start() + 1, "ignore-without-reason", message))
                continue
            alone = not line[: found.start()].strip()
            ignores[document.file, number + alone, found[1]] = (number, found.start() + 1)
    used: set[tuple[str, int, str]] = set()
    for warning in warnings:
        key = (warning.file, warning.line, warning.code)
        if key in ignores:
            used.add(key)
        else:
            kept.append(warning)
    for key in ignores.keys() - used:
        message = f"`ignore[{key[2]}]` silences nothing"
        kept.append(Problem(key[0], *ignores[key], "unused-ignore", message, "remove the comment"))
    return [replace(problem, level="warning") for problem in kept]


def check_rules(
    paths: Sequence[FilePath] | None,
    vocabulary: Vocabulary,
    operators: Mapping[str, Operator],
    probes: Mapping[str, Probe],
    *,
    shipped: bool = True,
    cases: FilePath | None = None,
    with_cases: bool = True,
) -> list[Problem]:
    """Return every error and warning of rule files, by file and line.

    Parameters
    ----------
    paths : sequence of pathlib.Path, optional
        Files in order of layering; with files given, only their warnings are returned, and those of the shipped rules
        when none is given.
    vocabulary, operators, probes : mappings
        What rules may speak of.
    shipped : bool
        Whether the shipped rules are the lowest layer.
    cases : pathlib.Path, optional
        Directory of the case files; the shipped one by default.
    with_cases : bool
        Whether to ask for cases at all.
    """
    merged, errors = inspect_rules(paths, vocabulary, operators, probes, shipped=shipped)
    if errors:
        return errors
    context = Context(merged, vocabulary, operators, probes)
    warnings = usage_warnings(context) + formula_warnings(context) + tie_warnings(context)
    if with_cases:
        files, case_errors = read_cases(merged, vocabulary, cases)
        warnings += _case_warnings(context, files)
        errors = case_errors
    documents = _documents_of_interest(merged, bool(paths) and shipped)
    names = {document.file for document in documents}
    return sorted(errors + _silence([item for item in warnings if item.file in names], documents))


def _documents_of_interest(merged: Merged, skip_first: bool) -> list[Document]:
    documents = [layer.document for layer in merged.layers]
    return documents[1:] if skip_first else documents


def as_json(problems: Iterable[Problem]) -> str:
    """Write problems as JSON, one object each."""
    return json.dumps([problem.as_dict() for problem in problems], indent=2, ensure_ascii=False)
