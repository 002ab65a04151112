"""How near every condition of every rule was to its limit: what would have to change little to change the decision."""

from __future__ import annotations

from collections.abc import Iterator

from expert.decision import ConditionRecord, Decision
from expert.explain.model import number
from expert.explain.record import check_digest, facts_of_stage
from expert.facts import Scalar, vocabulary
from expert.margins import MarginReader
from expert.plan import Record
from expert.rules.load import KnownRules
from expert.rules.model import STAGES, Stage
from modules.catalog import probes


class RuleMargin(Record):
    """One comparison of one rule with one field.

    Attributes
    ----------
    condition : ConditionRecord
        With value, limit and margin.
    share : float
        Magnitude of the margin over the larger one of value and limit: 0 at the limit.
    """

    rule: str
    name: str
    stage: Stage
    fired: bool
    condition: ConditionRecord
    share: float

    def text(self) -> str:
        """Write it as a clause."""
        item = self.condition
        margin = number(abs(item.margin or 0.0), item.unit)
        side = f"{margin} beyond the limit" if item.holds else f"{margin} short of the limit"
        side = "exactly at the limit" if item.margin == 0 else side
        inside = f" (inside {', '.join(item.within)})" if item.within else ""
        fired = "fired" if self.fired else "did not fire"
        return f"{self.rule} {self.name} {fired}; {_asks(item)}{inside}: {side}, {100 * self.share:.3g} %"


class FieldMargins(Record):
    """One field of one fact, and every limit that rules compare it with, the nearest first.

    Attributes
    ----------
    probe : str or None
        What measured it; None for what was stated or counted.
    share : float
        Of the nearest limit.
    """

    fact: str
    field: str
    value: Scalar
    unit: str
    description: str
    probe: str | None
    share: float
    rules: tuple[RuleMargin, ...]

    def text(self) -> str:
        """Write it as lines."""
        source = f"measured by {self.probe}" if self.probe else "stated"
        lines = [f"{self.fact}.{self.field} is {number(self.value, self.unit)} ({source})"]
        return "\n".join([*lines, *(f"  {rule.text()}" for rule in self.rules)])


class Margins(Record):
    """Every field that rules compare with a number, the nearest to a limit first."""

    fields: tuple[FieldMargins, ...]

    def text(self) -> str:
        """Write it as lines."""
        if not self.fields:
            return "No rule compares a measured number with a limit.\n"
        head = "How near each measured value was to the limits of the rules, the nearest first:"
        return "\n".join([head, *(item.text() for item in self.fields)]) + "\n"


def _asks(item: ConditionRecord) -> str:
    """Say what a comparison asks, without naming the fact again."""
    _, _, asked = item.text.partition(" is ")
    return f"asks that it is {asked}" if asked else item.text


def margins(decision: Decision, rules: KnownRules) -> Margins:
    """Return how near every condition was to its limit, of rules that fired and of rules that did not.

    Parameters
    ----------
    decision : Decision
    rules : KnownRules
        The rules of the decision.

    Raises
    ------
    ExplainError
        The rules are not those of the decision.

    Notes
    -----
    A condition inside `not`, `any_of` or a quantifier is compared by itself; `condition.within` says where it stands. A
    rule that fired several times is told for each fact that it fired on.
    """
    check_digest(decision, rules)
    words = vocabulary(probes().values())
    probe_of = {
        (record.template, name, value): record.probe
        for record in decision.facts
        for name, value in record.fields.items()
    }
    found: dict[tuple[str, str, Scalar], dict[tuple[str, str, tuple[str, ...]], RuleMargin]] = {}
    for item in _all(decision, rules):
        condition = item.condition
        if condition.fact is not None and condition.field is not None and condition.value is not None:
            place = condition.fact, condition.field, condition.value
            found.setdefault(place, {})[item.rule, condition.text, condition.within] = item
    fields = []
    for (fact, field, value), by_condition in found.items():
        near = tuple(sorted(by_condition.values(), key=lambda item: (item.share, item.rule, item.condition.text)))
        template = near[0].condition.template or fact
        info = words[template].fields.get(field) if template in words else None
        fields.append(
            FieldMargins(
                fact=fact,
                field=field,
                value=value,
                unit=near[0].condition.unit,
                description=info.description if info else "",
                probe=probe_of.get((template, field, value)),
                share=near[0].share,
                rules=near,
            )
        )
    return Margins(fields=tuple(sorted(fields, key=lambda item: (item.share, item.fact, item.field))))


def _all(decision: Decision, rules: KnownRules) -> Iterator[RuleMargin]:
    """Yield every comparison with a margin, of all stages that were reached."""
    words = vocabulary(probes().values())
    fired = {firing.rule for firing in decision.firings}
    for firing in decision.firings:
        yield from _of(firing.rule, firing.name, firing.stage, True, firing.conditions)
    for stage in STAGES:
        if stage != "measurement" and stage not in decision.plans:
            continue
        reader = MarginReader.over(words, rules.base.thresholds, facts_of_stage(decision, stage))
        for rule in rules.base.of_stage(stage):
            if rule.id not in fired:
                yield from _of(rule.id, rule.name, stage, False, reader.conditions(rule, {}))


def _of(
    rule: str, name: str, stage: Stage, fired: bool, conditions: tuple[ConditionRecord, ...]
) -> Iterator[RuleMargin]:
    for condition in conditions:
        if condition.margin is not None and condition.template not in ("planned", "trial", "finding", "failure"):
            share = float(f"{abs(condition.margin) / _scale(condition):.4g}")
            yield RuleMargin(rule=rule, name=name, stage=stage, fired=fired, condition=condition, share=share)


def _scale(condition: ConditionRecord) -> float:
    limits = condition.limit if isinstance(condition.limit, tuple) else (condition.limit,)
    numbers = [abs(float(item)) for item in (condition.value, *limits) if isinstance(item, int | float)]
    return max(max(numbers), 1e-9)
