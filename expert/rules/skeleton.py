"""The beginning of a new rule and of its cases: everything but what only its author knows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from expert.rules.model import Rule, Stage
from expert.rules.problem import RuleFileError
from expert.rules.reader import Document, read_document
from modules.operator import Operator
from modules.probe import Probe

PREFIXES: Mapping[Stage, str] = {
    "measurement": "MEA",
    "correction": "COR",
    "matching": "MAT",
    "reconstruction": "REC",
}
NEW_FILE = "version: 1\n\nrules:\n"


def next_id(stage: Stage, used: Iterable[str]) -> str:
    """Return the id after the highest one of a stage; ids are never used again, so gaps stay.

    Raises
    ------
    ValueError
        When the highest possible id is in use.

    Examples
    --------
    >>> next_id("correction", ["COR001", "COR016", "MAT030"])
    'COR017'
    """
    prefix = PREFIXES[stage]
    numbers = [int(name[3:]) for name in used if name.startswith(prefix) and name[3:].isdecimal()]
    number = max(numbers, default=0) + 1
    if number > 999:
        raise ValueError(f"{prefix}999 is in use, so that there is no next id; choose one by hand")
    return f"{prefix}{number:03d}"


def rule_skeleton(
    identifier: str, stage: Stage, name: str, operators: Mapping[str, Operator], probes: Mapping[str, Probe]
) -> str:
    """Return a new rule as an item of `rules:`, not indented.

    It names facts and operators that exist, and leaves the rationale and the references empty, so that the checks keep
    it from being used before they are written.
    """
    if stage == "measurement":
        known = sorted(probes, key=lambda item: (probes[item].tier == "cheap", item))
        action = f"measure: {known[0]}" if known else "derive: some-finding"
    else:
        named = sorted(item.name for item in operators.values() if item.stage == stage)
        action = f"choose: {named[0]}, score: 0.5" if named else "derive: some-finding"
    return (
        f"- id: {identifier}\n"
        f"  name: {name}\n"
        f"  stage: {stage}\n"
        f"  priority: {Rule.model_fields['priority'].default}\n"
        "  when:\n"
        "    - {fact: task, field: profile, op: eq, value: balanced}\n"
        "  then:\n"
        f"    - {{{action}}}\n"
        '  because: ""\n'
        "  references: []\n"
    )


def cases_skeleton() -> str:
    """Return the case file that goes with `rule_skeleton`: one case where it fires, one where it stays quiet."""
    return (
        "- name: fires in what it is made for\n"
        "  facts:\n"
        "    - {fact: task, profile: balanced}\n"
        "  fires: true\n"
        "\n"
        "- name: stays quiet otherwise\n"
        "  facts:\n"
        "    - {fact: task, profile: fast}\n"
        "  fires: false\n"
    )


def appended(file: str, raw: bytes, skeleton: str) -> str:
    """Return the text of a rule file with one more rule at its end; the rest stays as it is, byte for byte.

    Raises
    ------
    RuleFileError
        When the file cannot be read, or its `rules:` is not a list in block style at the end.
    """
    before = read_document(file, raw)
    text = raw.decode("utf-8")
    if isinstance(before.data, dict) and not before.data.get("rules") and ("rules",) not in before.keys:
        text, indent = text.rstrip() + "\n\nrules:\n", 2
    else:
        indent = _indent(before)
        text = text.rstrip() + ("\n\n" if _count(before) else "\n")
    newline = "\r\n" if "\r\n" in text else "\n"
    item = "".join(f"{' ' * indent}{line}" for line in skeleton.splitlines(keepends=True))
    result = text.replace("\r\n", "\n") + item
    result = result.replace("\n", newline)
    if not _is_extended(before, result):
        message = "`rules:` is not a block list at the end of the file"
        raise RuleFileError([before.problem(("rules",), "cannot-append", message, "paste the rule by hand", key=True)])
    return result


def _count(document: Document) -> int:
    rules = document.data.get("rules") if isinstance(document.data, dict) else None
    return len(rules) if isinstance(rules, list) else 0


def _indent(document: Document) -> int:
    """Return by how many blanks the dashes of the rules are indented."""
    return max(0, document.mark(("rules", 0))[1] - 3) if _count(document) else 2


def _is_extended(before: Document, result: str) -> bool:
    """Say whether a text holds what a document does, and one rule more."""
    try:
        after = read_document(before.file, result.encode()).data
    except RuleFileError:
        return False
    if not isinstance(before.data, dict) or not isinstance(after, dict) or not isinstance(after.get("rules"), list):
        return False
    old = {**before.data, "rules": before.data.get("rules") or []}
    return {**after, "rules": after["rules"][:-1]} == old and isinstance(after["rules"][-1], dict)
