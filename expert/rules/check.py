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
from expert.rules.cases import facts_of, read_cases
from expert.rules.checks.catalog import CHECKS, warnings
from expert.rules.checks.context import Context, GivenCase
from expert.rules.layers import Merged
from expert.rules.load import inspect_rules
from expert.rules.problem import Problem
from expert.rules.reader import Document
from modules.operator import Operator
from modules.probe import Probe

_IGNORE = re.compile(r"#\s*terrex:\s*ignore\[([a-z-]+)\][ \t]*(.*)$")


def _silence(found: Iterable[Problem], documents: Iterable[Document]) -> list[Problem]:
    """Leave out what comments silence; complain about comments without a reason or without an effect."""
    ignores: dict[tuple[str, int, str], tuple[int, int]] = {}
    kept: list[Problem] = []
    for document in documents:
        for number, line in enumerate(document.text.splitlines(), start=1):
            comment = _IGNORE.search(line)
            if not comment:
                continue
            if not comment[2].strip():
                message = f"`ignore[{comment[1]}]` gives no reason"
                kept.append(Problem(document.file, number, comment.start() + 1, "ignore-without-reason", message))
                continue
            alone = not line[: comment.start()].strip()
            ignores[document.file, number + alone, comment[1]] = (number, comment.start() + 1)
    used: set[tuple[str, int, str]] = set()
    for warning in found:
        key = (warning.file, warning.line, warning.code)
        if key in ignores:
            used.add(key)
        else:
            kept.append(warning)
    for key in ignores.keys() - used:
        message = f"`ignore[{key[2]}]` silences nothing"
        kept.append(Problem(key[0], *ignores[key], "unused-ignore", message, "remove the comment"))
    return [replace(problem, level=CHECKS[problem.code].level) for problem in kept]


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
        Whether to ask for cases at all. Without a directory, those of a file on top of the shipped rules cannot be
        found, and a rule without cases is a note.
    """
    merged, errors = inspect_rules(paths, vocabulary, operators, probes, shipped=shipped)
    if errors:
        return errors
    cases_of: dict[str, list[GivenCase]] | None = None
    if with_cases:
        files, errors = read_cases(merged, vocabulary, cases)
        if errors:
            return sorted(errors)
        cases_of = {file.rule: [GivenCase(facts_of(case), case.fires) for case, _ in file.cases] for file in files}
    nowhere = cases is None and bool(paths) and shipped
    folder = None if nowhere else "knowledge/cases" if cases is None else cases.as_posix()
    found = warnings(Context(merged, vocabulary, operators, probes, cases_of, folder))
    documents = _documents_of_interest(merged, bool(paths) and shipped)
    names = {document.file for document in documents}
    kept = _silence([item for item in found if item.file in names], documents)
    if nowhere:
        kept = [replace(item, level="note") if item.code == "missing-case" else item for item in kept]
    return sorted(kept)


def _documents_of_interest(merged: Merged, skip_first: bool) -> list[Document]:
    documents = [layer.document for layer in merged.layers]
    return documents[1:] if skip_first else documents


def as_json(problems: Iterable[Problem]) -> str:
    """Write problems as JSON, one object each."""
    return json.dumps([problem.as_dict() for problem in problems], indent=2, ensure_ascii=False)
