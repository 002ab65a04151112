"""Read YAML into plain data with the position of every key and value; nothing is ever constructed or expanded.

The reader works on parse events, with a stack of its own, so that neither deep nesting nor aliases can exhaust memory
or the call stack. It accepts the YAML that two people read alike: no aliases, no tags, no `yes` for true, no `1:30`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import yaml

from expert.rules.problem import Problem, RuleFileError

MAX_BYTES = 4_000_000
MAX_DEPTH = 40
MAX_NODES = 250_000  # a file of a thousand rules has about fifty thousand keys and values

Path: TypeAlias = tuple[str | int, ...]
Mark: TypeAlias = tuple[int, int]

_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]{0,17})")
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_AMBIGUOUS = re.compile(
    r"(?i:yes|no|on|off)|[-+]?\.(?i:inf|nan)|0[xob][0-9a-fA-F_]+|[-+]?0[0-9_]+|[-+]?[0-9][0-9_]*(:[0-9_.]+)+|[-+]?[0-9][0-9_]+"
    r"|\d{4}-\d\d?-\d\d?.*"
)
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class Document:
    """One file as plain data.

    Attributes
    ----------
    file : str
        Name for messages.
    data : dict, list or scalar
        The content.
    keys, values : dict from path to (line, column)
        Positions of keys and values, from 1; a path is the keys and indices that lead there.
    text : str
        The source, for comments.
    """

    file: str
    data: Any
    text: str
    keys: dict[Path, Mark] = field(default_factory=dict)
    values: dict[Path, Mark] = field(default_factory=dict)

    def mark(self, path: Path, *, key: bool = False) -> Mark:
        """Return the position of a path, or of its nearest ancestor that is written in the file."""
        while True:
            if key and path in self.keys:
                return self.keys[path]
            if path in self.values:
                return self.values[path]
            if not path:
                return (1, 1)
            path = path[:-1]

    def problem(self, path: Path, code: str, message: str, hint: str = "", *, key: bool = False) -> Problem:
        """Return a problem at a path."""
        line, column = self.mark(path, key=key)
        return Problem(self.file, line, column, code, message, hint)


@dataclass
class _Open:
    """A mapping or list that is being read."""

    path: Path
    content: dict[str, Any] | list[Any]
    pending: str | None = None

    def next_path(self) -> Path:
        if isinstance(self.content, list):
            return (*self.path, len(self.content))
        return (*self.path, self.pending or "")


class _Builder:
    """Builds a `Document` from parse events."""

    def __init__(self, file: str, text: str) -> None:
        self.document = Document(file, None, text)
        self.problems: list[Problem] = []
        self.stack: list[_Open] = []
        self.root: Any = None
        self.documents = 0
        self.nodes = 0

    def complain(self, event: Any, code: str, message: str, hint: str = "") -> None:
        mark = event.start_mark
        self.problems.append(Problem(self.document.file, mark.line + 1, mark.column + 1, code, message, hint))

    def _count(self, event: Any) -> None:
        self.nodes += 1
        if self.nodes >= MAX_NODES:
            self.complain(event, "too-large", f"more than {MAX_NODES} keys and values", "split it into layers")
            raise RuleFileError(self.problems)

    def feed(self, event: Any) -> None:
        if isinstance(event, yaml.DocumentStartEvent):
            self.documents += 1
            if self.documents == 2:
                self.complain(event, "several-documents", "the file holds more than one YAML document", "remove `---`")
        if self.documents > 1:
            return
        if isinstance(event, yaml.NodeEvent):
            self._count(event)
        if isinstance(event, yaml.AliasEvent):
            self.complain(event, "alias", f"alias '*{event.anchor}' is not allowed", "write the value out")
            self._place(event, None)
        elif isinstance(event, yaml.ScalarEvent):
            self._scalar(event)
        elif isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
            self._open(event)
        elif isinstance(event, yaml.MappingEndEvent | yaml.SequenceEndEvent):
            self.stack.pop()

    def _open(self, event: Any) -> None:
        self._refuse_tag(event)
        if len(self.stack) >= MAX_DEPTH:
            self.complain(event, "too-deep", f"nested more than {MAX_DEPTH} levels deep", "flatten the file")
            raise RuleFileError(self.problems)
        content: dict[str, Any] | list[Any] = {} if isinstance(event, yaml.MappingStartEvent) else []
        path = self._place(event, content)
        self.stack.append(_Open(path, content))

    def _refuse_tag(self, event: Any) -> None:
        if event.tag is not None and event.tag != "!":
            self.complain(event, "tag", f"tag '{event.tag}' is not allowed", "write plain YAML")

    def _scalar(self, event: Any) -> None:
        self._refuse_tag(event)
        top = self.stack[-1] if self.stack else None
        if top is not None and isinstance(top.content, dict) and top.pending is None:
            self._key(event, top, event.value)
            return
        self._place(event, self._value(event))

    def _key(self, event: Any, top: _Open, key: str) -> None:
        if not key.isprintable():
            self.complain(event, "key-not-text", f"key {key!r} has control characters", "write a name")
        path = (*top.path, key)
        if path in self.document.keys:
            line = self.document.keys[path][0]
            self.complain(event, "duplicate-key", f"key '{key}' is already on line {line}", "remove one of them")
            key = f"{key}\0{len(self.document.keys)}"
            path = (*top.path, key)
        self.document.keys[path] = (event.start_mark.line + 1, event.start_mark.column + 1)
        top.pending = key

    def _place(self, event: Any, value: Any) -> Path:
        mark = (event.start_mark.line + 1, event.start_mark.column + 1)
        if not self.stack:
            self.root = value
            self.document.values[()] = mark
            return ()
        top = self.stack[-1]
        if isinstance(top.content, dict) and top.pending is None:
            self.complain(event, "key-not-text", "a key must be plain text", "quote it or write a name")
            top.pending = f"\0{len(self.document.values)}"
            return (*top.path, top.pending)
        path = top.next_path()
        self.document.values[path] = mark
        if isinstance(top.content, list):
            top.content.append(value)
        else:
            if "\0" not in (top.pending or ""):
                top.content[top.pending or ""] = value
            top.pending = None
        return path

    def _value(self, event: Any) -> Any:
        text: str = event.value
        if not event.implicit[0]:
            return text
        if text in ("", "~", "null", "Null", "NULL"):
            return None
        if text in ("true", "True", "TRUE", "false", "False", "FALSE"):
            return text.lower() == "true"
        if _INTEGER.fullmatch(text):
            return int(text)
        if _AMBIGUOUS.fullmatch(text):
            self.complain(
                event,
                "ambiguous-value",
                f"{text[:40]!r} is read differently by different YAML readers",
                "write true, false or a finite decimal number, or quote it",
            )
            return None
        if _NUMBER.fullmatch(text):
            value = float(text)
            if math.isfinite(value):
                return value
            self.complain(event, "not-finite", f"number {text[:40]} is too large", "write a finite number")
            return None
        return text


def decode(file: str, raw: bytes) -> str:
    """Decode a file as UTF-8, or refuse it."""
    if len(raw) > MAX_BYTES:
        message = f"the file has {len(raw)} bytes, more than {MAX_BYTES}"
        raise RuleFileError([Problem(file, 1, 1, "too-large", message, "split it into layers")])
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        message = f"byte 0x{raw[error.start]:02x} is not UTF-8"
        raise RuleFileError([Problem(file, line, column, "not-utf8", message, "save the file as UTF-8")]) from error


def _syntax_problem(file: str, text: str, error: yaml.YAMLError) -> Problem:
    mark = getattr(error, "problem_mark", None)
    said = str(getattr(error, "problem", None) or getattr(error, "reason", None) or "not YAML")
    line, column = (mark.line + 1, mark.column + 1) if mark is not None else (1, 1)
    position = getattr(error, "position", None)
    if mark is None and isinstance(position, int):
        before = text[:position]
        line, column = before.count("\n") + 1, position - before.rfind("\n")
    lines = text.splitlines()
    shown = lines[line - 1] if line <= len(lines) else ""
    hint = "check indentation, brackets and quotes"
    if "\t" in shown[: len(shown) - len(shown.lstrip())]:
        hint = "indent with spaces, not tabs"
    return Problem(file, line, column, "yaml-syntax", " ".join(said.split()), hint)


def read_document(file: str, raw: bytes) -> Document:
    """Read one YAML file.

    Raises
    ------
    RuleFileError
        When the file is no YAML, or YAML that is not accepted here; it carries all problems that were found.
    """
    text = decode(file, raw)
    builder = _Builder(file, text)
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            builder.feed(event)
    except yaml.YAMLError as error:
        raise RuleFileError([*builder.problems, _syntax_problem(file, text, error)]) from error
    if builder.problems:
        raise RuleFileError(builder.problems)
    document = builder.document
    return Document(file, builder.root, text, document.keys, document.values)
