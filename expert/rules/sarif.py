"""Write problems of rule files as SARIF, which code hosts and editors show beside the lines."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TypedDict
from urllib.parse import quote

from expert.rules.checks.catalog import CHECKS
from expert.rules.problem import Problem

SARIF_VERSION = "2.1.0"
SARIF_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"


class _Text(TypedDict):
    text: str


class _Rule(TypedDict):
    id: str
    shortDescription: _Text
    fullDescription: _Text
    help: _Text


def _uri(file: str) -> str:
    path = Path(file)
    return path.as_uri() if path.is_absolute() else quote(path.as_posix())


def _result(problem: Problem, index: int) -> dict[str, object]:
    sentence = problem.message + (f"; {problem.hint}" if problem.hint else "")
    return {
        "ruleId": problem.code,
        "ruleIndex": index,
        "level": problem.level,
        "message": {"text": sentence},
        "locations": [
            {
                "physicalLocation": {
                    "artifactLocation": {"uri": _uri(problem.file)},
                    "region": {"startLine": problem.line, "startColumn": problem.column},
                }
            }
        ],
    }


def _rule(code: str) -> _Rule:
    """Describe a code by what its check says of itself."""
    short, check = code.replace("-", " "), CHECKS.get(code)
    reports, why, remedy = (check.reports, check.why, check.remedy) if check else (short, short, short)
    return {
        "id": code,
        "shortDescription": {"text": reports},
        "fullDescription": {"text": why},
        "help": {"text": remedy},
    }


def as_sarif(problems: Iterable[Problem]) -> str:
    """Write problems as a SARIF 2.1.0 log with one run; columns count Unicode characters.

    References
    ----------
    OASIS, "Static Analysis Results Interchange Format (SARIF) Version 2.1.0", 2020.
    """
    found = list(problems)
    codes = sorted({problem.code for problem in found})
    rules = [_rule(code) for code in codes]
    log = {
        "$schema": SARIF_SCHEMA,
        "version": SARIF_VERSION,
        "runs": [
            {
                "tool": {"driver": {"name": "terrex", "rules": rules}},
                "columnKind": "unicodeCodePoints",
                "results": [_result(problem, codes.index(problem.code)) for problem in found],
            }
        ],
    }
    return json.dumps(log, indent=2, ensure_ascii=False)
