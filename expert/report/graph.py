"""The decision as a graph: facts lead to rules, rules to findings and choices, the beaten ones included."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from expert.decision import ConditionRecord, Decision, FiringRecord
from expert.explain.record import findings_in
from expert.plan import NONE, Step
from expert.report.rows import INTERNAL, condition_line
from expert.report.words import fact_title, number_text, short_title, unit_text
from expert.rules.boxes import Box, place
from expert.rules.load import KnownRules
from expert.rules.model import STAGES, Rule

Kind = Literal["fact", "rule", "finding", "choice", "lost"]
Key = tuple[Kind, str]  # a fact's title, `stage rule`, a finding's name, `stage.slot operator`
LINE_LENGTH, MOST_LINES = 30, 4
COLUMN_GAP = 56.0
BOLD = 7.3  # px, mean width of a character of the names


@dataclass(frozen=True)
class Node:
    """One box.

    Attributes
    ----------
    key : (kind, name)
    lines : tuple of str
        The first is its name.
    label : str
        All of it in words, for screen readers.
    """

    key: Key
    lines: tuple[str, ...]
    label: str


@dataclass(frozen=True)
class Edge:
    """One arrow; `absent` where the rule asks that something is not so, `lost` where what it asked for was beaten."""

    source: Key
    target: Key
    label: str
    absent: bool = False
    lost: bool = False


@dataclass(frozen=True)
class DecisionGraph:
    """Nodes and edges, in an order that hangs on nothing but the record."""

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]


@dataclass(frozen=True)
class DrawnNode:
    """A node as it stands in the picture."""

    number: int
    kind: Kind
    lines: tuple[str, ...]
    label: str
    box: Box
    about: str  # id of the element of the page that tells more


@dataclass(frozen=True)
class DrawnEdge:
    """An edge as it stands in the picture; source and target are numbers of nodes."""

    source: int
    target: int
    label: str
    absent: bool
    lost: bool
    path: str


@dataclass(frozen=True)
class Drawing:
    """What the template draws."""

    nodes: tuple[DrawnNode, ...]
    edges: tuple[DrawnEdge, ...]
    width: float
    height: float


@dataclass
class _Builder:
    """Collects nodes and edges of one decision; the same edge told twice is drawn once."""

    decision: Decision
    rules: Mapping[str, Rule]
    nodes: dict[Key, Node] = field(default_factory=dict)
    edges: dict[tuple[Key, Key], Edge] = field(default_factory=dict)
    read: dict[Key, dict[str, str]] = field(default_factory=dict)

    def node(self, kind: Kind, name: str, lines: list[str], label: str) -> Key:
        key: Key = (kind, name)
        if key not in self.nodes:
            self.nodes[key] = Node(key, tuple(lines), label)
        return key

    def edge(self, source: Key, target: Key, label: str, *, absent: bool = False, lost: bool = False) -> None:
        known = self.edges.get((source, target))
        if known is None:
            self.edges[source, target] = Edge(source, target, label, absent, lost)
        elif label not in known.label.split("; "):
            joined = f"{known.label}; {label}"
            self.edges[source, target] = Edge(source, target, joined, known.absent and absent, known.lost and lost)

    def firing(self, firing: FiringRecord) -> None:
        rule = self.rule(firing.rule, firing.stage, firing.name)
        for item in firing.conditions:
            if item.fact is not None and item.template not in INTERNAL:
                fact = self.fact(short_title(item.fact), item)
                self.edge(fact, rule, condition_line(item), absent="not" in item.within)
        for record in firing.bindings.values():
            if record.template not in INTERNAL and not any(
                item.template == record.template for item in firing.conditions
            ):
                self.edge(self.fact(fact_title(record)), rule, f"asks for {record.template}")

    def fact(self, title: str, item: ConditionRecord | None = None) -> Key:
        key: Key = ("fact", title)
        fields = self.read.setdefault(key, {})
        if item is not None and item.field is not None and item.value is not None:
            unit = unit_text(item.template or "", item.field)
            fields[item.field] = f"{item.field} {number_text(item.value)}{unit}"
        self.nodes[key] = Node(
            key, (title, *fields.values()), ": ".join(filter(None, [f"Fact {title}", ", ".join(fields.values())]))
        )
        return key

    def rule(self, rule: str, stage: str, name: str) -> Key:
        return self.node("rule", f"{stage} {rule}", [rule, name], f"Rule {rule} {name} fired in {stage}")

    def asked_measurements(self, firing: FiringRecord, rule: Key) -> None:
        """Join a rule that asks for a measurement to those of its facts that rules fired on, or else to the first."""
        for action in firing.actions:
            probe = action.text.removeprefix("measure ")
            if action.kind == "measure":
                titles = [fact_title(record) for record in self.decision.facts if record.probe == probe]
                known = [title for title in titles if ("fact", title) in self.nodes]
                for title in known or titles[:1]:
                    self.edge(rule, self.fact(title), f"asked for {probe}")

    def findings(self) -> None:
        """Join findings to the rules that derived them and to those that ask for them."""
        for finding in self.decision.findings:
            lines = [finding.name, finding.severity]
            key = self.node("finding", finding.name, lines, f"{finding.severity} finding: {finding.sentence}")
            for rule in finding.rules:
                for firing in self.decision.firings:
                    if firing.rule == rule:
                        self.edge(("rule", f"{firing.stage} {rule}"), key, f"{rule} found it")
        for firing in self.decision.firings:
            target: Key = ("rule", f"{firing.stage} {firing.rule}")
            for name in self.asked_findings(firing):
                if ("finding", name) in self.nodes and ("rule", f"{firing.stage} {firing.rule}") in self.nodes:
                    self.edge(("finding", name), target, f"{firing.rule} asks for {name}")

    def asked_findings(self, firing: FiringRecord) -> Iterator[str]:
        bound = {str(fact.fields.get("name")) for fact in firing.bindings.values() if fact.template == "finding"}
        known = self.rules.get(firing.rule)
        asked = {item.finding for item in findings_in(known.when)} if known else set()
        derived = {finding.name for finding in self.decision.findings if firing.rule in finding.rules}
        yield from sorted((bound | asked) - derived)

    def choices(self) -> None:
        for stage, plan in self.decision.plans.items():
            for step in plan.steps:
                if step.chosen_by or step.losers or any(rule != "default" for rule in step.set_by.values()):
                    self.step(stage, step)
        for firing in self.decision.firings:
            for record in firing.bindings.values():
                source: Key = ("choice", f"{record.fields.get('slot')} {record.fields.get('operator')}")
                if record.template == "planned" and source in self.nodes:
                    self.edge(source, ("rule", f"{firing.stage} {firing.rule}"), "asks for this choice")

    def step(self, stage: str, step: Step) -> None:
        slot = f"{stage}.{step.slot}"
        winner = self.choice("choice", slot, step.operator, "the default" if step.chosen_by is None else "chosen")
        if step.chosen_by is not None:
            self.edge(self.source(stage, step.chosen_by), winner, f"{step.chosen_by} chose {step.operator}")
        for parameter, rule in step.set_by.items():
            if rule not in (step.chosen_by, "default"):
                value = number_text(step.parameters.get(parameter))
                self.edge(self.source(stage, rule), winner, f"{rule} set {parameter} to {value}")
        for setting in step.lost_settings:
            told = f"{setting.rule} wanted {setting.parameter} {number_text(setting.value)}: {setting.lost_because}"
            self.edge(self.source(stage, setting.rule), winner, told, lost=True)
        for loser in step.losers:
            if loser.rule is not None or loser.operator != NONE:
                score = "default" if loser.rule is None else f"score {loser.score:g}"
                beaten = self.choice("lost", slot, loser.operator, f"beaten, {score}")
                self.edge(winner, beaten, f"beat it: {loser.lost_because}", lost=True)
                if loser.rule is not None:
                    told = f"{loser.rule} proposed it: {loser.lost_because}"
                    self.edge(self.source(stage, loser.rule), beaten, told, lost=True)
                self.excluded(stage, loser.operator, beaten)

    def excluded(self, stage: str, operator: str, beaten: Key) -> None:
        for firing in self.decision.firings:
            if any(action.kind == "exclude" and action.text == f"exclude {operator}" for action in firing.actions):
                self.edge(self.source(stage, firing.rule), beaten, f"{firing.rule} excludes it", absent=True)

    def choice(self, kind: Kind, slot: str, operator: str, what: str) -> Key:
        name = "nothing" if operator == NONE else operator.partition(".")[2] or operator
        words = f"{'Choice' if kind == 'choice' else 'Beaten'} for {slot}: {name}, {what}"
        return self.node(kind, f"{slot} {operator}", [slot, name, what], words)

    def source(self, stage: str, rule: str) -> Key:
        """Return the node of a rule, in this stage where it fired there."""
        stages = [firing.stage for firing in self.decision.firings if firing.rule == rule]
        where = stage if stage in stages or not stages else stages[0]
        known = self.rules.get(rule)
        return self.rule(rule, where, known.name if known else "asked for after an earlier trial")


def decision_graph(decision: Decision, rules: KnownRules | None = None) -> DecisionGraph:
    """Return the graph of a decision: what rules fired on, and what came of it.

    Parameters
    ----------
    decision : Decision
    rules : KnownRules, optional
        With them also findings are joined to the rules that ask for them without naming the fact.
    """
    builder = _Builder(decision, rules.base.by_id if rules else {})
    order = sorted(decision.firings, key=lambda firing: (STAGES.index(firing.stage), firing.rule))
    for firing in order:
        builder.firing(firing)
    for firing in order:
        builder.asked_measurements(firing, ("rule", f"{firing.stage} {firing.rule}"))
    builder.findings()
    builder.choices()
    return DecisionGraph(tuple(builder.nodes.values()), tuple(builder.edges.values()))


def draw(graph: DecisionGraph, about: Mapping[Key, str]) -> Drawing:
    """Lay a graph out from left to right.

    Parameters
    ----------
    graph : DecisionGraph
    about : dict
        For each node the id of the element of the page that tells more.
    """
    texts = {node.key: _wrapped(node.lines) for node in graph.nodes}
    placed = place(
        texts, [(edge.source, edge.target) for edge in graph.edges], column_gap=COLUMN_GAP, late=True, character=BOLD
    )
    numbers = {node.key: number for number, node in enumerate(graph.nodes)}
    nodes = tuple(
        DrawnNode(
            numbers[node.key], node.key[0], texts[node.key], node.label, placed.boxes[node.key], about.get(node.key, "")
        )
        for node in graph.nodes
    )
    edges = tuple(
        DrawnEdge(numbers[edge.source], numbers[edge.target], edge.label, edge.absent, edge.lost, path)
        for edge, path in zip(graph.edges, placed.paths, strict=True)
    )
    return Drawing(nodes, edges, placed.width, placed.height)


def _wrapped(lines: tuple[str, ...]) -> tuple[str, ...]:
    """Break long lines, and leave out what is beyond the most lines."""
    found = [part for line in lines for part in textwrap.wrap(line, LINE_LENGTH) or [""]]
    return tuple(found if len(found) <= MOST_LINES else [*found[: MOST_LINES - 1], "..."])
