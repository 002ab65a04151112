"""Text and YAML files that hold numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from modules.formats.errors import FormatError

MAX_TEXT_BYTES = 1_000_000


def read_text(path: Path, what: str) -> str:
    """Return the text of a small file, or raise a `FormatError` that says why not."""
    if not path.exists():
        raise FormatError(f"{path} does not exist; check the path of the {what}")
    if path.is_dir():
        raise FormatError(f"{path} is a folder; give the {what} file inside it")
    try:
        size = path.stat().st_size
        if size > MAX_TEXT_BYTES:
            raise FormatError(
                f"{path} has {size} bytes, above {MAX_TEXT_BYTES} for a {what}; "
                "it is another kind of file, check the path"
            )
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not text ({error.reason} at byte {error.start}); give a {what} file") from error
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check its permissions") from error


def read_mapping(path: Path, text: str, what: str, allowed: Iterable[str]) -> Mapping[str, object]:
    """Parse a YAML mapping whose keys are all among `allowed`."""
    import yaml

    try:
        loaded = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise FormatError(f"{path} is not YAML ({' '.join(str(error).split())}); correct it") from error
    if not isinstance(loaded, dict):
        raise FormatError(
            f"{path} holds {type(loaded).__name__} and a {what} is a mapping; write lines of 'name: value'"
        )
    names = sorted(allowed)
    unknown = [str(key) for key in loaded if key not in names]
    if unknown:
        import difflib

        near = difflib.get_close_matches(unknown[0], names, 1)
        hint = f"did you mean '{near[0]}'?" if near else f"possible are {', '.join(names)}"
        raise FormatError(f"{path} has unknown field '{unknown[0]}'; {hint}")
    return loaded


def number(path: Path, mapping: Mapping[str, object], key: str, default: float | None = None) -> float:
    """Return a finite number of a mapping."""
    if key not in mapping:
        if default is None:
            raise FormatError(f"{path} has no '{key}'; add a line '{key}: value'")
        return default
    return finite(path, key, mapping[key])


def finite(path: Path, key: str, value: object) -> float:
    """Return `value` as a finite float."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise FormatError(f"{path}: {key} is {value!r} and must be a number")
    try:
        result = float(value)
    except ValueError as error:
        raise FormatError(f"{path}: {key} is {value!r} and must be a number") from error
    if not math.isfinite(result):
        raise FormatError(f"{path}: {key} is {value!r} and must be finite")
    return result


def numbers(path: Path, key: str, value: object, count: int) -> list[float]:
    """Return `value` as a list of `count` finite floats."""
    if not isinstance(value, list) or len(value) != count:
        raise FormatError(f"{path}: {key} is {value!r} and must be a list of {count} numbers")
    return [finite(path, f"{key}[{index}]", item) for index, item in enumerate(value)]


def write_text(path: Path, text: str) -> None:
    """Write a text file, or raise a `FormatError` that says why not."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, or raise a `FormatError` that says why not."""
    try:
        path.write_bytes(content)
    except OSError as error:
        raise FormatError(
            f"{path} cannot be written ({error.strerror}); check the folder and its permissions"
        ) from error
