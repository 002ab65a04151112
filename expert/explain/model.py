"""What explanations return: closed records, each with a text that an engineer would write."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from expert.facts import Scalar
from expert.plan import Record


def number(value: Scalar | None, unit: str = "1") -> str:
    """Write a value with its unit.

    Examples
    --------
    >>> number(6.0, "dn"), number(None), number(True)
    ('6 dn', 'absent', 'true')
    """
    if value is None:
        return "absent"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if unit in ("", "1") else f"{text} {unit}"


class Node(Record):
    """One sentence, and what it rests on."""

    sentence: str
    children: tuple[Node, ...] = ()

    def lines(self, depth: int = 0) -> Iterator[str]:
        """Return the sentence and those below it, indented."""
        yield "  " * depth + self.sentence
        for child in self.children:
            yield from child.lines(depth + 1)


class How(Record):
    """How a choice came about: a tree of firings, conditions and facts."""

    subject: str
    nodes: tuple[Node, ...]

    def text(self) -> str:
        """Write it as indented lines."""
        return "\n".join(line for node in self.nodes for line in node.lines()) + "\n"


class RuleVerdict(Record):
    """What one rule would have done, and what kept it from it.

    Attributes
    ----------
    condition, value, limit, unit, margin
        The first condition that fails, what was measured, its limit and the distance between the two; None where a
        condition has no single number.
    would_win : bool or None
        Whether its score and priority would have won the slot; None for a rule that chooses nothing.
    below : tuple of RuleVerdict
        Where the condition asks for a finding: the rules that would have derived it.
    """

    rule: str
    name: str
    source: str
    would: str
    fired: bool
    condition: str | None = None
    value: Scalar | None = None
    limit: Scalar | None = None
    unit: str = "1"
    margin: float | None = None
    would_win: bool | None = None
    below: tuple[RuleVerdict, ...] = ()

    def text(self) -> str:
        """Write it as lines; indented, what kept the finding away that it asks for."""
        lines = [self._sentence()]
        lines += [f"  {line}" for rule in self.below for line in rule.text().splitlines()]
        return "\n".join(lines)

    def _sentence(self) -> str:
        head = f"{self.rule} {self.name} ({self.source}) would {self.would}"
        if self.fired:
            return f"{self.rule} {self.name} ({self.source}) fired: {self.would}."
        if self.condition is None:
            return f"{head}; its conditions hold on the recorded facts, but not in the inference that was kept."
        text = f"{head}, but this does not hold: {self.condition}"
        if self.margin is not None:
            text += f" (measured {number(self.value, self.unit)}, limit {number(self.limit, self.unit)}"
            text += f", short by {number(self.margin, self.unit)})"
        elif self.value is not None:
            text += f" (measured {number(self.value, self.unit)})"
        if self.would_win is False:
            text += "; even then it would have lost by score or priority"
        return text + "."


Outcome = Literal["chosen", "lost", "excluded", "failed", "tried", "conditions", "never", "fired", "not_reached"]


class WhyNot(Record):
    """Why an operator was not chosen, or why a rule did not fire."""

    name: str
    kind: Literal["operator", "rule"]
    outcome: Outcome
    sentence: str
    rules: tuple[RuleVerdict, ...] = ()

    def text(self) -> str:
        """Write it as lines."""
        lines = [self.sentence, *(f"  {line}" for rule in self.rules for line in rule.text().splitlines())]
        return "\n".join(lines) + "\n"


class Change(Record):
    """One field of a fact, as it was recorded and as it is assumed."""

    fact: str
    field: str
    before: Scalar | None
    after: Scalar | None
    unit: str = "1"

    def text(self) -> str:
        """Write it as a clause."""
        return f"{self.fact}.{self.field}: {number(self.before, self.unit)} -> {number(self.after, self.unit)}"


class StepChange(Record):
    """A slot whose operator or parameters change."""

    slot: str
    before: str
    after: str
    parameters: tuple[Change, ...] = ()
    before_by: str | None = None
    after_by: str | None = None

    def text(self) -> str:
        """Write it as one line."""
        if self.before != self.after:
            return f"{self.slot}: {self.before} ({_by(self.before_by)}) -> {self.after} ({_by(self.after_by)})"
        changed = ", ".join(f"{item.field} {number(item.before)} -> {number(item.after)}" for item in self.parameters)
        return f"{self.slot}: {self.after} stays, with {changed}"


def _by(rule: str | None) -> str:
    return rule or "default"


class WhatIf(Record):
    """What changes when facts had other values; nothing was measured or run for it."""

    changes: tuple[Change, ...]
    steps: tuple[StepChange, ...]
    findings_gone: tuple[str, ...] = ()
    findings_new: tuple[str, ...] = ()
    fired_no_more: tuple[str, ...] = ()
    fired_instead: tuple[str, ...] = ()
    repairs_gone: tuple[str, ...] = ()
    repairs_new: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """Write it as lines."""
        lines = ["If " + " and ".join(change.text() for change in self.changes) + ":"]
        lines += [f"  {step.text()}" for step in self.steps] or ["  the plan stays as it is"]
        for title, items in (
            ("findings gone", self.findings_gone),
            ("new findings", self.findings_new),
            ("rules that no longer fire", self.fired_no_more),
            ("rules that fire instead", self.fired_instead),
            ("no longer asked of the next trial", self.repairs_gone),
            ("asked of the next trial", self.repairs_new),
        ):
            if items:
                lines.append(f"  {title}: {', '.join(items)}")
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines) + "\n"


class Way(Record):
    """Changes of facts that together bring the choice about.

    Attributes
    ----------
    cost : float
        Sum over the changes of |after - before| relative to the larger of the two magnitudes; 1 for a word or a yes/no.
    """

    changes: tuple[Change, ...]
    cost: float
    chosen_by: str | None = None

    def text(self) -> str:
        """Write it as one line."""
        return " and ".join(change.text() for change in self.changes) + f" (then chosen by {_by(self.chosen_by)})"


class WhatItTakes(Record):
    """The smallest changes of facts that flip a choice, or that there is none."""

    slot: str
    operator: str
    now: str
    ways: tuple[Way, ...] = ()
    tried: int = 0
    complete: bool = True
    already: bool = False
    proposed_by: tuple[str, ...] = ()

    def text(self) -> str:
        """Write it as lines."""
        if self.already:
            return f"{self.slot} is filled by {self.operator} already.\n"
        if not self.ways:
            return f"{self._none()}\n"
        lines = [f"{self.slot} would be {self.operator} instead of {self.now} with, the smallest change first:"]
        return "\n".join([*lines, *(f"  {way.text()}" for way in self.ways)]) + "\n"

    def _none(self) -> str:
        if not self.proposed_by:
            return (
                f"No change of facts gives {self.operator} instead of {self.now} in {self.slot}: "
                "no rule ever chooses it, and it is not the default."
            )
        rules = ", ".join(self.proposed_by)
        if not self.complete:
            return (
                f"No change was found that gives {self.operator} instead of {self.now} in {self.slot}; "
                f"the search stopped after {self.tried} plans. It is proposed by: {rules}."
            )
        return (
            f"No change of one or two fields gives {self.operator} instead of {self.now} in {self.slot} "
            f"(all {self.tried} at the limits of the rules were tried). It is proposed by: {rules}."
        )
