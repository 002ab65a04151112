"""Lay out rule files alike: indentation, blanks and line ends; comments and the order of everything stay."""

from __future__ import annotations

import io
import re
from typing import Any

from expert.rules.problem import Problem, RuleFileError
from expert.rules.reader import decode, read_document

_WIDE = 1_000_000  # lines are broken by their author only


def _yaml() -> Any:
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = _WIDE
    yaml.brace_single_entry_mapping_in_flow_sequence = True
    yaml.indent(mapping=2, sequence=4, offset=2)
    return yaml


def _once(text: str) -> str:
    yaml = _yaml()
    stream = io.StringIO()
    data = yaml.load(text)
    if data is None:  # nothing but comments
        return text.strip("\n") + "\n" if text.strip() else ""
    yaml.dump(data, stream)
    lines = [line.rstrip() for line in stream.getvalue().split("\n")]
    if isinstance(data, list):  # a list at the top is not indented
        lines = [line.removeprefix("  ") for line in lines]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip("\n") + "\n"


def format_rules(file: str, raw: bytes) -> str:
    """Return a rule file in the common layout.

    Parameters
    ----------
    file : str
        Name for messages.
    raw : bytes
        The file; it may have a byte order mark and any line ends.

    Raises
    ------
    RuleFileError
        When the file cannot be read, or cannot be laid out without a change of what it says.
    """
    from ruamel.yaml.error import YAMLError

    before = read_document(file, raw)
    text = decode(file, raw).replace("\r\n", "\n").replace("\r", "\n")
    try:
        result = _once(text)
        settled = _once(result) == result
    except (YAMLError, ValueError) as error:
        raise _refusal(file, f"it cannot be laid out: {' '.join(str(error).split())}") from error
    if read_document(file, result.encode()).data != before.data:
        raise _refusal(file, "laying it out would change what it says")
    if not settled or _comments(result) != _comments(text):
        raise _refusal(file, "laying it out would move comments")
    return result


def _refusal(file: str, message: str) -> RuleFileError:
    return RuleFileError([Problem(file, 1, 1, "not-formatted", message, "lay it out by hand")])


def _comments(text: str) -> list[str]:
    return [found[1].strip() for line in text.splitlines() if (found := re.search(r"(?:^|\s)(#.*)$", line))]
