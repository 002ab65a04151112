"""Names that a question to a log speaks of: no rows for one that nothing has would read as if it never happened."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from expert.cli.usage import UsageError

if TYPE_CHECKING:
    from expert.batch.runlog import RunLog
    from expert.rules.layers import Merged


def check_names(
    log: RunLog,
    *,
    status: str | None = None,
    rules: Sequence[str | None] = (),
    finding: str | None = None,
    operator: str | None = None,
    fact: str | None = None,
) -> None:
    """Refuse a name that is neither in the log nor among what can be in one.

    Parameters
    ----------
    log : RunLog
    status, finding, operator : str, optional
    rules : sequence of str or None
    fact : str, optional
        May hold `*` and `?`.

    Raises
    ------
    UsageError
        With the nearest names.
    """
    from expert.batch.work import OutcomeStatus
    from expert.trials import FAILED, GIVEN_UP
    from modules.catalog import operators

    if status is not None:
        _check("status", status, get_args(OutcomeStatus))
    wanted = [name for name in rules if name is not None]
    for what, table, names in (("rule", "firings", wanted), ("finding", "findings", [finding] if finding else [])):
        logged = _logged(log, table, what)
        if any(name not in logged for name in names):
            merged = _rules_of(log)
            named = (
                set(merged.rules) | merged.disabled if what == "rule" else {FAILED, GIVEN_UP, *merged.named_findings}
            )
            for name in names:
                _check(what, name, logged | named)
    if operator is not None:
        _check("operator", operator, {"none", *_logged(log, "steps", "operator"), *operators()})
    if fact is not None:
        logged = _logged(log, "facts", "fact")
        if not fnmatch.filter(logged | set(_fields()), fact.replace("[", "[[]")):
            _check("fact", fact, logged or set(_fields()))


def _check(what: str, name: str, known: Sequence[str] | set[str]) -> None:
    from expert.rules.problem import suggest

    if name not in known:
        hint = suggest(name, known)
        raise UsageError(f"there is no {what} {name}, logged or known" + (f"; {hint}" if hint else ""))


def _logged(log: RunLog, table: str, column: str) -> set[str]:
    return {str(name) for (name,) in log.query(f"SELECT DISTINCT {column} FROM {table}")[1]}


def _rules_of(log: RunLog) -> Merged:
    """Return the shipped rules with those of the files that the runs name, as far as these are still there."""
    from expert.cli.rule_common import words
    from expert.rules.load import inspect_rules
    from modules.catalog import operators, probes

    files = dict.fromkeys(str(path) for settings in log.settings() for path in _listed(settings.get("rule files")))
    there = [Path(name) for name in files if Path(name).is_file()]
    return inspect_rules(there, words(), operators(), probes())[0]


def _listed(value: object) -> list[object]:
    return value if isinstance(value, list) else []


def _fields() -> Iterator[str]:
    from expert.cli.rule_common import words

    for template in words().values():
        yield from (f"{template.name}.{name}" for name in template.fields)
