"""The shape of a rule file: validate each item by its model, and say where in the file each fault is."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from expert.rules.model import ACTIONS, STAGES, Model, Rule, Slot, Stage, Threshold
from expert.rules.problem import Problem, suggest
from expert.rules.reader import Document, Path

SECTIONS = ("version", "thresholds", "findings", "slots", "disable", "rules")
_OPERAND_KEYS = frozenset({"to", "round", "floor", "ceil"})
_M = TypeVar("_M", bound=BaseModel)


@dataclass
class Layer:
    """One file: the items that have the right shape, each with its path, and what it declares at all.

    `thresholds`, `findings`, `slots` and `rules` hold sound items only; the `named_` sets also hold the names of items
    that are faulty, so that one fault is not reported again wherever the item is used. Of `incomplete` rules only the
    sound conditions and actions are held, with gaps between them.
    """

    document: Document
    thresholds: dict[str, tuple[Threshold, Path]] = field(default_factory=dict)
    findings: dict[str, tuple[str, Path]] = field(default_factory=dict)
    slots: dict[tuple[Stage, str], tuple[Slot, Path]] = field(default_factory=dict)
    rules: dict[str, tuple[Rule, Path]] = field(default_factory=dict)
    disable: list[tuple[str, Path]] = field(default_factory=list)
    named_thresholds: set[str] = field(default_factory=set)
    named_findings: set[str] = field(default_factory=set)
    named_slots: set[tuple[str, str]] = field(default_factory=set)
    named_rules: set[str] = field(default_factory=set)
    incomplete: set[str] = field(default_factory=set)
    problems: list[Problem] = field(default_factory=list)

    def complain(self, path: Path, code: str, message: str, hint: str = "", *, key: bool = False) -> None:
        """Note a problem."""
        self.problems.append(self.document.problem(path, code, message, hint, key=key))


def _resolve(loc: tuple[str | int, ...], data: Any) -> tuple[Path, bool]:
    """Follow a pydantic location through the data; union tags in it are skipped.

    Returns the path, and whether the location lies in a branch of a union that cannot be meant (the branch for a list
    where no list is written, or the other way round).
    """
    path: list[str | int] = []
    tag_next = False
    for part in loc:
        if isinstance(part, str) and "[" in part and not (isinstance(data, dict) and part in data):
            if part.startswith("list[") != isinstance(data, list):
                return tuple(path), True
            tag_next = True
        elif isinstance(part, int):
            if not isinstance(data, list) or part >= len(data):
                break
            path.append(part)
            data = data[part]
            tag_next = True
        elif tag_next:
            tag_next = False
        elif isinstance(data, dict):
            tag_next = part in _OPERAND_KEYS or (bool(path) and path[-1] == "with")
            path.append(part)
            if part not in data:
                break
            data = data[part]
    return tuple(path), False


def _words(error: Any) -> tuple[str, str]:
    """Return a code and a sentence for one pydantic error."""
    kind = error["type"]
    limits = error.get("ctx", {})
    shown = repr(error["input"])
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    if kind in ("less_than_equal", "greater_than_equal"):
        word = "at most" if kind.startswith("less") else "at least"
        return "out-of-range", f"is {shown}, but must be {word} {limits.get('le', limits.get('ge'))}"
    if kind == "literal_error":
        return "unknown-value", f"is {shown}, but must be one of {limits.get('expected')}"
    if kind == "string_pattern_mismatch":
        pattern = str(limits.get("pattern"))
        return "wrong-pattern", f"is {shown}, but must be {_PATTERNS.get(pattern, f'like {pattern}')}"
    if kind in ("too_short", "string_too_short"):
        return "too-short", f"is too short, at least {limits.get('min_length')} needed"
    if kind == "too_long":
        return "too-long", f"is too long, at most {limits.get('max_length')} allowed"
    wanted = {
        "string_type": "text", "int_type": "a whole number", "float_type": "a number", "list_type": "a list",
        "dict_type": "a mapping", "model_type": "a mapping", "model_attributes_type": "a mapping",
        "bool_type": "true or false",
    }.get(kind)  # fmt: skip
    if wanted:
        return "wrong-type", f"is {shown}, but must be {wanted}"
    if kind == "union_tag_not_found":
        return "unknown-action", f"{shown} is no action"
    return "wrong-type", f"is {shown}: {error['msg'].lower()}"


_PATTERNS = {
    "^[A-Z]{3}[0-9]{3}$": "three capital letters and three digits, e.g. COR012",
    "^[a-z][a-z0-9-]*$": "small letters, digits and hyphens, e.g. exposure-differs-globally",
    r"^[a-z_][a-z0-9_]*\.[a-z_][a-z0-9_]*$": "alias.field, e.g. brightness.mean_difference_dn",
}


def _field_name(path: Path) -> str:
    names = [part for part in path if isinstance(part, str)]
    return f"'{names[-1]}'" if names else "it"


def place_of(path: Path) -> str:
    """Name the condition or action a path inside a rule leads to, counted from 1."""
    if len(path) >= 2 and isinstance(path[1], int) and path[0] in ("when", "then"):
        return f", {'condition' if path[0] == 'when' else 'action'} {path[1] + 1}"
    return ""


def _known_keys(model: type[BaseModel]) -> set[str]:
    return {info.alias or name for name, info in model.model_fields.items()}


def _errors(error: ValidationError, data: Any) -> Iterator[tuple[Path, Any, str]]:
    """Yield path, error and joined type words; the branches of one union give one error."""
    grouped: dict[Path, list[Any]] = {}
    for item in error.errors(include_url=False):
        path, impossible = _resolve(item["loc"], data)
        if not impossible:
            grouped.setdefault(path, []).append(item)
    if not grouped:
        yield (), error.errors(include_url=False)[0], ""
    for path, items in grouped.items():
        yield path, items[0], "a number, text, true or false" if len(items) > 1 else ""


_ABSENT = ("missing", "too_short", "string_too_short")
_EVIDENCE = {
    "because": (
        "missing-rationale",
        ("it does not say why", "write `because:` with the reason, at least 10 characters"),
    ),
    "references": ("missing-reference", ("it names no source", "write `references:` with a paper or a script")),
}


def validate(layer: Layer, model: type[_M], data: Any, path: Path, subject: str) -> _M | None:
    """Build a model from data, or note what is wrong with the data."""
    try:
        return model.model_validate(data, strict=True)
    except ValidationError as error:
        for inner, item, union in _errors(error, data):
            where = subject + place_of(inner)
            full = (*path, *inner)
            if len(inner) == 1 and inner[0] in _EVIDENCE and item["type"] in _ABSENT:
                code, said = _EVIDENCE[str(inner[0])]
                missing = item["type"] == "missing"
                layer.complain(full[:-1] if missing else full, code, f"{where}: {said[0]}", said[1])
            elif item["type"] == "missing":
                layer.complain(full[:-1], "missing-key", f"{where}: {_field_name(inner)} is missing", "add it")
            elif item["type"] == "extra_forbidden" and inner:
                known = _siblings(model, data, inner)
                layer.complain(
                    full, "unknown-key", f"{where}: unknown key {_field_name(inner)}",
                    suggest(str(inner[-1]), known) if known else "remove it", key=True,
                )  # fmt: skip
            else:
                code, words = _words(item)
                if union and code == "wrong-type":
                    code, words = "wrong-type", f"is {_short(item['input'])}, but must be {union}"
                name = "" if code == "unknown-action" else f"{_field_name(inner)} "
                layer.complain(full, code, f"{where}: {name}{words}", _fix(code, item))
    except RecursionError:
        layer.complain(path, "too-deep", f"{subject} is nested too deep", "flatten it")
    return None


def _short(value: Any) -> str:
    shown = repr(value)
    return shown if len(shown) <= 60 else shown[:57] + "..."


_OTHER_WORDS = {
    "<": "lt", "<=": "le", ">": "gt", ">=": "ge", "=": "eq", "==": "eq", "!=": "ne", "below": "lt", "above": "gt",
    "less": "lt", "greater": "gt", "equals": "eq", "is": "eq", "exists": "present", "missing": "absent",
}  # fmt: skip


def _fix(code: str, error: Any) -> str:
    if code == "unknown-action":
        written = [key for key in error["input"] if isinstance(key, str)] if isinstance(error["input"], dict) else []
        near = (suggest(key, ACTIONS) for key in written)
        return next((hint for hint in near if hint.startswith("did")), f"known: {', '.join(ACTIONS)}")
    if code == "unknown-value":
        options = re.findall(r"'([^']*)'", str(error.get("ctx", {}).get("expected", "")))
        meant = _OTHER_WORDS.get(str(error["input"]).lower(), "")
        hint = f"did you mean '{meant}'?" if meant in options else suggest(str(error["input"]), options)
        return hint if hint.startswith("did") else ""
    return "correct the value" if code == "wrong-type" else ""


_INNER_KEYS = {
    "when": {"fact", "as", "field", "op", "value", "unit", "finding", "at_least"},
    "then": {
        "derive", "measure", "choose", "exclude", "set", "assess", "adjust", "repair", "severity", "slot", "with",
        "score", "parameter", "to", "by", "times", "at_least", "at_most",
    },
}  # fmt: skip


def _siblings(model: type[BaseModel], data: Any, inner: Path) -> set[str]:
    """Return the keys that could have been meant, without those that are written already."""
    known = _known_keys(model) if len(inner) == 1 else _INNER_KEYS.get(str(inner[0]), set())
    parent = data
    for part in inner[:-1]:
        parent = parent[part]
    return known - set(parent) if isinstance(parent, dict) else known


def _mapping(layer: Layer, data: Any, path: Path, subject: str) -> dict[str, Any]:
    if data is None:
        return {}
    if not isinstance(data, dict):
        layer.complain(path, "wrong-type", f"{subject} must be a mapping, not {_short(data)}", "write `name: ...`")
        return {}
    return data


def _list(layer: Layer, data: Any, path: Path, subject: str) -> list[Any]:
    if data is None:
        return []
    if not isinstance(data, list):
        layer.complain(path, "wrong-type", f"{subject} must be a list, not {_short(data)}", "write `- ...` per item")
        return []
    return data


def _read_slots(layer: Layer, data: Any) -> None:
    for stage, items in _mapping(layer, data, ("slots",), "'slots'").items():
        if stage not in STAGES:
            layer.complain(
                ("slots", stage), "unknown-stage", f"there is no stage '{stage}'", suggest(stage, STAGES), key=True
            )
            continue
        for index, item in enumerate(_list(layer, items, ("slots", stage), f"slots of {stage}")):
            path: Path = ("slots", stage, index)
            name = item.get("slot") if isinstance(item, dict) else None
            slot = validate(layer, Slot, item, path, f"slot {index + 1} of {stage}" if name is None else f"slot {name}")
            if isinstance(name, str):
                if (stage, name) in layer.named_slots:
                    layer.complain(path, "duplicate-id", f"slot {stage}.{name} is declared twice", "remove one")
                layer.named_slots.add((stage, name))
            if slot is not None:
                layer.slots.setdefault((stage, slot.slot), (slot, path))


_STAND_INS = {"id": "AAA000", "name": "unnamed", "because": "the reason is missing", "references": ["none"]}
_NOTHING: dict[str, dict[str, object]] = {"when": {"fact": "nothing"}, "then": {"derive": "nothing"}}


class Gap(Model):
    """What stands in the place of a faulty condition or action, so that the others keep theirs; no check reads it."""


def _sound_part(item: Any) -> Rule | None:
    """Return a rule with a gap for every faulty condition and action, so that the rest of it is checked, too."""
    try:
        Rule.model_validate(item, strict=True)
    except ValidationError as error:
        faulty = [found["loc"] for found in error.errors(include_url=False)]
    except RecursionError:
        return None
    keys = {str(loc[0]) for loc in faulty if loc}
    if not isinstance(item, dict) or not keys or not isinstance(item.get("id"), str):
        return None
    patched = {key: value for key, value in item.items() if key not in keys}
    if "stage" in keys:
        patched["stage"] = next(iter(difflib.get_close_matches(str(item.get("stage")), STAGES, n=1)), None)
    patched.update({key: value for key, value in _STAND_INS.items() if key in keys})
    wrong = {loc[:2] for loc in faulty if len(loc) > 1}
    for key in keys & _NOTHING.keys():
        written = item[key] if isinstance(item.get(key), list) and item[key] else [None]
        wrong |= {(key, index) for index, part in enumerate(written) if part is None}
        patched[key] = [_NOTHING[key] if (key, index) in wrong else part for index, part in enumerate(written)]
    try:
        rule = Rule.model_validate(patched, strict=True)
    except ValidationError:
        return None
    parts = {
        key: [Gap() if (key, index) in wrong else part for index, part in enumerate(getattr(rule, key))]
        for key in _NOTHING
    }
    return rule.model_copy(update={"id": item["id"], **parts})


def _read_rules(layer: Layer, data: Any) -> None:
    for index, item in enumerate(_list(layer, data, ("rules",), "'rules'")):
        path: Path = ("rules", index)
        name = item.get("id") if isinstance(item, dict) else None
        rule = validate(layer, Rule, item, path, f"rule {index + 1}" if name is None else f"rule {name}")
        if isinstance(name, str):
            if name in layer.named_rules:
                first = layer.rules.get(name)
                line = f" on line {layer.document.mark(first[1])[0]}" if first else ""
                layer.complain(
                    (*path, "id"), "duplicate-id", f"rule id {name} is already used{line}", "give it an id of its own"
                )
            layer.named_rules.add(name)
        if rule is None:
            rule = _sound_part(item)
            layer.incomplete.update({rule.id} if rule else ())
        if rule is not None:
            layer.rules.setdefault(rule.id, (rule, path))


def read_layer(document: Document) -> Layer:
    """Check the shape of one file, item by item, so that every fault is found."""
    layer = Layer(document)
    if not isinstance(document.data, dict):
        message = "the file is empty" if document.data is None else "the file must be a mapping at its top"
        layer.complain((), "wrong-type", message, f"sections: {', '.join(SECTIONS)}")
        return layer
    data = document.data
    for key in data:
        if key not in SECTIONS:
            layer.complain((key,), "unknown-key", f"unknown section '{key}'", suggest(key, SECTIONS), key=True)
    version = data.get("version", 1)
    if version != 1 or isinstance(version, bool):
        layer.complain(("version",), "wrong-version", f"version is {_short(version)}, this program reads 1", "write 1")
    for name, item in _mapping(layer, data.get("thresholds"), ("thresholds",), "'thresholds'").items():
        layer.named_thresholds.add(name)
        threshold = validate(layer, Threshold, item, ("thresholds", name), f"threshold {name}")
        if threshold is not None:
            layer.thresholds[name] = (threshold, ("thresholds", name))
    for name, item in _mapping(layer, data.get("findings"), ("findings",), "'findings'").items():
        layer.named_findings.add(name)
        if isinstance(item, str):
            layer.findings[name] = (item, ("findings", name))
        else:
            layer.complain(("findings", name), "wrong-type", f"finding {name} must be described by text", "describe it")
    for index, item in enumerate(_list(layer, data.get("disable"), ("disable",), "'disable'")):
        if isinstance(item, str):
            layer.disable.append((item, ("disable", index)))
        else:
            layer.complain(("disable", index), "wrong-type", f"{_short(item)} is not a rule id", "write an id")
    _read_slots(layer, data.get("slots"))
    _read_rules(layer, data.get("rules"))
    return layer
