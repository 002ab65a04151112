"""Load rule files: read, check the shape, lay them over each other, check every reference.

A later file overrides the rules, thresholds, findings and slots of an earlier one by id or name, and disables rules by
id. All problems of all files are reported together.
"""

from __future__ import annotations

import hashlib
import json
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path as FilePath
from types import FrameType

from expert.facts import Vocabulary
from expert.rules.checks.catalog import errors
from expert.rules.checks.context import Context
from expert.rules.layers import Merged, merge
from expert.rules.model import RuleBase
from expert.rules.problem import Problem, RuleFileError
from expert.rules.reader import MAX_BYTES, Document, read_document
from expert.rules.shape import Layer, read_layer
from modules.operator import Operator
from modules.probe import Probe

SHIPPED = "knowledge/rules.yaml"


@dataclass(frozen=True)
class KnownRules:
    """A rule base that is sound, and where each rule is written.

    Attributes
    ----------
    base : RuleBase
        The merged rules; disabled ones are gone.
    positions : dict from rule id to (file, line)
        Where each rule begins.
    digest : str
        SHA-256 of the canonical JSON of the rule base.
    """

    base: RuleBase
    positions: Mapping[str, tuple[str, int]]
    digest: str


@dataclass(frozen=True)
class LoadedRules(KnownRules):
    """Rules read from files.

    Attributes
    ----------
    merged : Merged
        The same with the origin of every item, for checks.
    """

    merged: Merged = field(repr=False)


@contextmanager
def _interrupt_deferred() -> Iterator[None]:
    """Let an interrupt from the terminal wait: pydantic takes one for a value that it cannot write, and goes on."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[FrameType | None] = []
    handler = signal.signal(signal.SIGINT, lambda _, frame: came.append(frame))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if came and callable(handler):
        handler(signal.SIGINT, came[0])


def canonical_json(base: RuleBase) -> str:
    """Return a rule base as JSON in one form; the order of rules does not matter, that of slots does."""
    with _interrupt_deferred():
        data = base.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["rules"] = sorted(data["rules"], key=lambda rule: rule["id"])
    return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def digest_of(base: RuleBase) -> str:
    """Return the SHA-256 of a rule base's canonical JSON."""
    return hashlib.sha256(canonical_json(base).encode()).hexdigest()


def shipped_file() -> FilePath | None:
    """Return the path of the shipped rules, or None when they are not a file of their own."""
    path = FilePath(str(resources.files("knowledge"))) / "rules.yaml"
    return path if path.is_file() else None


def _read_shipped() -> Document:
    try:
        raw = resources.files("knowledge").joinpath("rules.yaml").read_bytes()
    except (OSError, ModuleNotFoundError) as error:
        message = "the shipped rules are not installed"
        raise RuleFileError([Problem(SHIPPED, 1, 1, "unreadable", message, "reinstall terrex")]) from error
    return read_document(SHIPPED, raw)


def _read_file(path: FilePath) -> Document:
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        said = getattr(error, "strerror", None) or str(error)
        problem = Problem(str(path), 1, 1, "unreadable", f"cannot read the file: {said}", "check the path")
        raise RuleFileError([problem]) from error
    return read_document(str(path), raw)


def read_layers(paths: Sequence[FilePath] | None, *, shipped: bool = True) -> tuple[list[Layer], list[Problem]]:
    """Read the shipped file and the given ones, in order, with all problems of their syntax and shape."""
    layers: list[Layer] = []
    problems: list[Problem] = []
    for path in [*([None] if shipped else []), *(paths or [])]:
        try:
            document = _read_shipped() if path is None else _read_file(FilePath(path))
        except RuleFileError as error:
            problems.extend(error.problems)
            continue
        layer = read_layer(document)
        problems.extend(layer.problems)
        layers.append(layer)
    return layers, problems


def inspect_rules(
    paths: Sequence[FilePath] | None,
    vocabulary: Vocabulary,
    operators: Mapping[str, Operator],
    probes: Mapping[str, Probe],
    *,
    shipped: bool = True,
) -> tuple[Merged, list[Problem]]:
    """Load rules as far as possible; return them with every error found."""
    layers, problems = read_layers(paths, shipped=shipped)
    merged, more = merge(layers)
    problems += more
    problems += errors(Context(merged, vocabulary, operators, probes))
    return merged, sorted(set(problems))


def load_rules(
    paths: Sequence[FilePath] | None,
    vocabulary: Vocabulary,
    operators: Mapping[str, Operator],
    probes: Mapping[str, Probe],
    *,
    shipped: bool = True,
) -> LoadedRules:
    """Load the shipped rules with files layered on top of them.

    Parameters
    ----------
    paths : sequence of pathlib.Path, optional
        Files in order; a later one wins.
    vocabulary, operators, probes : mappings
        What rules may speak of.
    shipped : bool
        Whether the shipped rules are the lowest layer.

    Raises
    ------
    RuleFileError
        When any file has an error; it carries all of them.
    """
    merged, problems = inspect_rules(paths, vocabulary, operators, probes, shipped=shipped)
    if problems:
        raise RuleFileError(problems)
    base = merged.base()
    positions = {
        name: (origin.document.file, origin.document.mark(origin.path)[0]) for name, (_, origin) in merged.rules.items()
    }
    return LoadedRules(base, positions, digest_of(base), merged)
