"""Text and YAML files that hold numbers."""

from __future__ import annotations

import errno
import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from modules.formats.errors import FormatError

MAX_TEXT_BYTES = 1_000_000


def read_text(path: Path, what: str, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """Return the text of a small file, or raise a `FormatError` that says why not."""
    if not path.exists():
        raise FormatError(f"{path} does not exist; check the path of the {what}")
    if path.is_dir():
        raise FormatError(f"{path} is a folder; give the {what} file inside it")
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise FormatError(
                f"{path} has {size} bytes, above {max_bytes} for a {what}; it is another kind of file, check the path"
            )
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not text ({error.reason} at byte {error.start}); give a {what} file") from error
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check its permissions") from error


def parse_yaml(path: Path | str, text: str) -> object:
    """Parse one YAML document, or raise a `FormatError` that says where it is wrong."""
    import yaml

    if text.startswith("%YAML:"):  # OpenCV's header is no YAML directive
        text = text.partition("\n")[2]
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise FormatError(f"{path} is not YAML ({' '.join(str(error).split())}); correct it") from error


def as_mapping(path: Path | str, loaded: object, what: str) -> Mapping[str, object]:
    """Return what a YAML file holds as a mapping, or say what it holds instead."""
    if not isinstance(loaded, dict):
        raise FormatError(
            f"{path} holds {type(loaded).__name__} and a {what} is a mapping; write lines of 'name: value'"
        )
    return loaded


def unknown_field(path: Path | str, name: str, allowed: Iterable[str]) -> FormatError:
    """Return the error of a field that does not exist, with the nearest one that does."""
    import difflib

    names = sorted(allowed)
    near = difflib.get_close_matches(name, names, 1)
    hint = f"did you mean '{near[0]}'?" if near else f"possible are {', '.join(names)}"
    return FormatError(f"{path} has unknown field '{name}'; {hint}")


def read_mapping(path: Path, text: str, what: str, allowed: Iterable[str]) -> Mapping[str, object]:
    """Parse a YAML mapping whose keys are all among `allowed`."""
    loaded = as_mapping(path, parse_yaml(path, text), what)
    names = sorted(allowed)
    for key in loaded:
        if key not in names:
            raise unknown_field(path, str(key), names)
    return loaded


def number(path: Path | str, mapping: Mapping[str, object], key: str, default: float | None = None) -> float:
    """Return a finite number of a mapping."""
    if key not in mapping:
        if default is None:
            raise FormatError(f"{path} has no '{key}'; add a line '{key}: value'")
        return default
    return finite(path, key, mapping[key])


def finite(path: Path | str, key: str, value: object) -> float:
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


def numbers(path: Path | str, key: str, value: object, count: int) -> list[float]:
    """Return `value` as a list of `count` finite floats."""
    if not isinstance(value, list) or len(value) != count:
        raise FormatError(f"{path}: {key} is {value!r} and must be a list of {count} numbers")
    return [finite(path, f"{key}[{index}]", item) for index, item in enumerate(value)]


def whole(path: Path | str, key: str, value: float) -> int:
    """Return a number of pixels, which must be whole."""
    if value != round(value):
        raise FormatError(f"{path}: {key} is {value:g} and must be a whole number of px")
    return round(value)


def write_text(path: Path, text: str) -> None:
    """Write a text file, or raise a `FormatError` that says why not."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, or raise a `FormatError` that says why not."""
    try:
        path.write_bytes(content)
    except OSError as error:
        raise unwritable(path, error) from error


def unwritable(path: Path | str, error: OSError) -> FormatError:
    """Return the error of a file that cannot be written, with the remedy for its cause."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    remedy = "make room on the disk" if full else "check the folder and its permissions"
    return FormatError(f"{path} cannot be written ({error.strerror}); {remedy}")
