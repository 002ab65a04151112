"""What two rule bases mean differently: rules, thresholds, findings and slots, said in words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from difflib import SequenceMatcher
from typing import Literal, TypeVar

from expert.facts import Vocabulary
from expert.rules.checks.context import thresholds_in
from expert.rules.explain import action_text, condition_text, sentence
from expert.rules.model import Rule, RuleBase, Slot, Threshold

Item = TypeVar("Item")
How = Literal["added", "removed", "changed", "reworded"]


@dataclass(frozen=True)
class Difference:
    """One difference.

    Attributes
    ----------
    how : str
        `reworded` is a change of names, rationales or references, which no decision depends on.
    what : str
        `rule COR012`, `threshold noise_dn`, `finding noisy`, `slot matching.matcher`.
    field : str
        What of it; empty for the whole.
    before, after : str
        In words; empty where there is none.
    """

    how: How
    what: str
    field: str = ""
    before: str = ""
    after: str = ""

    def __str__(self) -> str:
        """Write it as one line."""
        place = f"{self.how:<9}{self.what}" + (f", {self.field}" if self.field else "")
        if self.before and self.after:
            return f"{place}: {self.before} -> {self.after}"
        if not self.field:
            return f"{place}: {self.before or self.after}"
        return f"{place}: {'no longer ' + self.before if self.before else 'now also ' + self.after}"

    def as_dict(self) -> dict[str, str]:
        """Return it as plain data for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class _Side:
    """One of the two rule bases."""

    base: RuleBase
    vocabulary: Vocabulary

    def rule(self, rule: Rule) -> str:
        return sentence(rule, self.vocabulary, self.base.thresholds)


def _items(
    what: str, field: str, old: Sequence[Item], new: Sequence[Item], said: Callable[[Item, int], str]
) -> list[Difference]:
    """Compare two lists of conditions or actions; `said` writes an item of the old (0) or new (1) one."""
    found: list[Difference] = []
    matcher = SequenceMatcher(None, [repr(item) for item in old], [repr(item) for item in new], autojunk=False)
    for tag, first, last, start, end in matcher.get_opcodes():
        if tag == "equal":
            continue
        gone, come = list(old[first:last]), list(new[start:end])
        for one, two in zip(gone, come, strict=False):
            found.append(Difference("changed", what, field, said(one, 0), said(two, 1)))
        found += [Difference("changed", what, field, before=said(item, 0)) for item in gone[len(come) :]]
        found += [Difference("changed", what, field, after=said(item, 1)) for item in come[len(gone) :]]
    return found


def _rule(old: Rule, new: Rule, sides: tuple[_Side, _Side]) -> list[Difference]:
    what = f"rule {old.id}"
    found = [
        Difference("changed", what, name, str(getattr(old, name)), str(getattr(new, name)))
        for name in ("stage", "priority")
        if getattr(old, name) != getattr(new, name)
    ]
    found += _items(
        what,
        "condition",
        old.when,
        new.when,
        lambda item, side: condition_text(item, sides[side].vocabulary, sides[side].base.thresholds),
    )
    found += _items(
        what, "action", old.then, new.then, lambda item, side: action_text(item, sides[side].base.thresholds)
    )
    for name in ("name", "because", "references"):
        before, after = getattr(old, name), getattr(new, name)
        if before != after:
            texts = ["; ".join(text) if isinstance(text, list) else " ".join(text.split()) for text in (before, after)]
            found.append(Difference("reworded", what, name, *texts))
    return found


def _users(sides: Iterable[_Side], name: str) -> str:
    users = {rule.id for side in sides for rule in side.base.rules if name in thresholds_in(rule)}
    return f" ({', '.join(sorted(users))})" if users else ""


def _threshold(threshold: Threshold) -> str:
    return f"{threshold.value:g}" + (f" {threshold.unit}" if threshold.unit != "1" else "")


def _thresholds(sides: tuple[_Side, _Side]) -> list[Difference]:
    old, new = (side.base.thresholds for side in sides)
    found: list[Difference] = []
    for name in sorted({*old, *new}):
        what = f"threshold {name}{_users(sides, name)}"
        if name not in old or name not in new:
            found.append(_one_sided(what, name, old, new, _threshold))
            continue
        one, two = old[name], new[name]
        if (one.value, one.unit) != (two.value, two.unit):
            found.append(Difference("changed", what, "value", _threshold(one), _threshold(two)))
        if one.because != two.because:
            found.append(Difference("reworded", what, "because", one.because, two.because))
    return found


def _one_sided(
    what: str, name: str, old: Mapping[str, Item], new: Mapping[str, Item], said: Callable[[Item], str]
) -> Difference:
    if name in old:
        return Difference("removed", what, before=said(old[name]))
    return Difference("added", what, after=said(new[name]))


def _slots(sides: tuple[_Side, _Side]) -> list[Difference]:
    old, new = ({f"{stage}.{s.slot}": s for stage, row in side.base.slots.items() for s in row} for side in sides)
    found: list[Difference] = []
    for name in sorted({*old, *new}):
        what = f"slot {name}"
        if name not in old or name not in new:
            found.append(_one_sided(what, name, old, new, _default))
        elif _default(old[name]) != _default(new[name]):
            found.append(Difference("changed", what, "default", _default(old[name]), _default(new[name])))
        elif old[name].because != new[name].because:
            found.append(Difference("reworded", what, "because", old[name].because, new[name].because))
    for stage in sorted({*sides[0].base.slots, *sides[1].base.slots}):
        orders = [[s.slot for s in side.base.slots.get(stage, [])] for side in sides]
        if orders[0] != orders[1] and set(orders[0]) == set(orders[1]):
            found.append(
                Difference("changed", f"slots of {stage}", "order", ", ".join(orders[0]), ", ".join(orders[1]))
            )
    return found


def _default(slot: Slot) -> str:
    values = ", ".join(f"{name} {value}" for name, value in sorted(slot.with_.items()))
    return slot.default + (f" with {values}" if values else "")


def rule_differences(old: RuleBase, new: RuleBase, vocabulary: Vocabulary) -> list[Difference]:
    """Return every difference of two rule bases; the order of rules is none, that of slots is one.

    Parameters
    ----------
    old, new : RuleBase
        With their layers merged.
    vocabulary : mapping
        For the units of fields.
    """
    sides = (_Side(old, vocabulary), _Side(new, vocabulary))
    found = _thresholds(sides)
    for name in sorted({*old.findings, *new.findings}):
        what = f"finding {name}"
        if name not in old.findings or name not in new.findings:
            found.append(_one_sided(what, name, old.findings, new.findings, str))
        elif old.findings[name] != new.findings[name]:
            found.append(Difference("reworded", what, "sentence", old.findings[name], new.findings[name]))
    found += _slots(sides)
    before, after = old.by_id, new.by_id
    for identifier in sorted({*before, *after}):
        what = f"rule {identifier}"
        if identifier not in after:
            found.append(Difference("removed", what, before=sides[0].rule(before[identifier])))
        elif identifier not in before:
            found.append(Difference("added", what, after=sides[1].rule(after[identifier])))
        else:
            found += _rule(before[identifier], after[identifier], sides)
    return found
