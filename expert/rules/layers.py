"""Layers: rule files laid over each other, every item with the place where it is written."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

from expert.rules.model import STAGES, Rule, RuleBase, Slot, Stage, Threshold
from expert.rules.problem import Problem, suggest
from expert.rules.reader import Document, Path
from expert.rules.shape import Layer

_T = TypeVar("_T")


@dataclass(frozen=True)
class Origin:
    """Where an item of the rule base is written."""

    document: Document
    path: Path

    def problem(self, inner: Path, code: str, message: str, hint: str = "") -> Problem:
        """Return a problem at a path inside the item."""
        return self.document.problem((*self.path, *inner), code, message, hint)


@dataclass(frozen=True)
class Merged:
    """Layers laid over each other, each item with its origin."""

    rules: Mapping[str, tuple[Rule, Origin]]
    thresholds: Mapping[str, tuple[Threshold, Origin]]
    findings: Mapping[str, tuple[str, Origin]]
    slots: Mapping[tuple[Stage, str], tuple[Slot, Origin]]
    named_thresholds: frozenset[str]
    named_findings: frozenset[str]
    named_slots: frozenset[tuple[str, str]]
    incomplete: frozenset[str] = frozenset()
    disabled: frozenset[str] = frozenset()
    layers: tuple[Layer, ...] = ()

    def base(self) -> RuleBase:
        """Return the rule base without positions."""
        slots: dict[Stage, list[Slot]] = {stage: [] for stage in STAGES}
        for (stage, _), (slot, _) in self.slots.items():
            slots[stage].append(slot)
        return RuleBase(
            thresholds={name: item for name, (item, _) in self.thresholds.items()},
            findings={name: item for name, (item, _) in self.findings.items()},
            slots={stage: items for stage, items in slots.items() if items},
            rules=[rule for rule, _ in self.rules.values()],
        )


def merge(layers: Sequence[Layer]) -> tuple[Merged, list[Problem]]:
    """Lay files over each other: later items replace earlier ones of the same name, in the earlier one's place."""
    rules: dict[str, tuple[Rule, Origin]] = {}
    thresholds: dict[str, tuple[Threshold, Origin]] = {}
    findings: dict[str, tuple[str, Origin]] = {}
    slots: dict[tuple[Stage, str], tuple[Slot, Origin]] = {}
    disabled: set[str] = set()
    named: set[str] = set()
    problems: list[Problem] = []
    for layer in layers:
        document = layer.document
        named |= layer.named_rules
        for name, path in layer.disable:
            if name not in named:
                hint = suggest(name, named)
                problems.append(document.problem(path, "unknown-rule", f"there is no rule {name} to disable", hint))
            disabled.add(name)
        disabled -= layer.named_rules - {name for name, _ in layer.disable}
        rules.update({name: (rule, Origin(document, path)) for name, (rule, path) in layer.rules.items()})
        thresholds.update({name: (item, Origin(document, path)) for name, (item, path) in layer.thresholds.items()})
        findings.update({name: (text, Origin(document, path)) for name, (text, path) in layer.findings.items()})
        slots.update({key: (slot, Origin(document, path)) for key, (slot, path) in layer.slots.items()})
    merged = Merged(
        rules={name: item for name, item in rules.items() if name not in disabled},
        thresholds=thresholds,
        findings=findings,
        slots=slots,
        named_thresholds=frozenset().union(*(layer.named_thresholds for layer in layers)),
        named_findings=frozenset().union(*(layer.named_findings for layer in layers)),
        named_slots=frozenset().union(*(layer.named_slots for layer in layers)),
        incomplete=frozenset().union(*(layer.incomplete for layer in layers)),
        disabled=frozenset(disabled),
        layers=tuple(layers),
    )
    return merged, problems


def written_in(merged: Merged, section: Literal["rules", "thresholds", "findings", "slots"], name: Hashable) -> str:
    """Say where an item is written, and over which lower ones: `rig.yaml:5, over knowledge/rules.yaml:230`."""
    places = [
        f"{layer.document.file}:{layer.document.mark(getattr(layer, section)[name][1])[0]}"
        for layer in reversed(merged.layers)
        if name in getattr(layer, section)
    ]
    return ", over ".join(places)


def overridden(
    layers: Sequence[Layer], items: Callable[[Layer], Mapping[str, tuple[_T, Path]]]
) -> Iterator[tuple[_T, Origin, _T, Origin]]:
    """Yield every item that takes the place of one of its name in a lower layer, and that one, each with its origin."""
    below: dict[str, tuple[_T, Origin]] = {}
    for layer in layers:
        for name, (item, path) in items(layer).items():
            origin = Origin(layer.document, path)
            if name in below:
                yield item, origin, *below[name]
            below[name] = (item, origin)
