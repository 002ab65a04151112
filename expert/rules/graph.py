"""The rule base as a graph: which facts and findings lead through which rules to which findings, slots and probes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from expert.rules.checks.context import walk
from expert.rules.model import (
    STAGES,
    Action,
    Adjust,
    Assess,
    Choose,
    Comparison,
    Derive,
    Exclude,
    Measure,
    Repair,
    Rule,
    RuleBase,
    Set,
    Stage,
)
from expert.rules.strata import EVERY_FINDING, uses
from modules.operator import Operator
from modules.probe import Probe

Kind = Literal["fact", "finding", "rule", "slot", "probe"]
_SHAPES: Mapping[Kind, tuple[str, str]] = {
    "fact": ("[(", ")]"),
    "finding": ("{{", "}}"),
    "rule": ("[", "]"),
    "slot": ("([", "])"),
    "probe": ("[/", "/]"),
}


@dataclass(frozen=True, order=True)
class Node:
    """A rule or something that rules read or write; `stage` groups rules and slots."""

    kind: Kind
    name: str
    label: str
    stage: str = ""


@dataclass(frozen=True, order=True)
class Edge:
    """An arrow; `negated` where the rule asks for the absence of what the arrow comes from."""

    source: tuple[Kind, str]
    target: tuple[Kind, str]
    label: str = ""
    negated: bool = False


@dataclass(frozen=True)
class Graph:
    """Nodes and edges, each sorted."""

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]


def _read(rule: Rule) -> set[Edge]:
    """Return the arrows into a rule."""
    here: tuple[Kind, str] = ("rule", rule.id)
    edges = set[Edge]()
    fields: dict[tuple[str, bool], set[str]] = {}
    for condition, path, _ in walk(rule):
        if isinstance(condition, Comparison) and condition.fact != "finding":
            negated = "not" in path or condition.op == "absent"
            fields.setdefault((condition.fact, negated), set()).add(condition.field or "")
    for (fact, negated), names in fields.items():
        edges.add(Edge(("fact", fact), here, ", ".join(sorted(filter(None, names))), negated))
    for use in uses(rule.when):
        edges.add(Edge(("finding", use.name), here, "", use.negated))
    return edges


def _place(name: str, slot: str | None, stage: Stage, operators: Mapping[str, Operator]) -> tuple[Kind, str]:
    operator = operators.get(name)
    return ("slot", f"{operator.stage}.{operator.slot}" if operator else f"{stage}.{slot or '?'}")


def _written(rule: Rule, action: Action, operators: Mapping[str, Operator]) -> Edge:
    """Return the arrow out of a rule that one action makes."""
    here: tuple[Kind, str] = ("rule", rule.id)
    if isinstance(action, Derive):
        return Edge(here, ("finding", action.derive), "derive")
    if isinstance(action, Assess):
        return Edge(here, ("finding", action.assess), "assess")
    if isinstance(action, Measure):
        return Edge(here, ("probe", action.measure), "measure")
    if isinstance(action, Choose):
        return Edge(here, _place(action.choose, action.slot, rule.stage, operators), f"choose {action.choose}")
    if isinstance(action, Repair):
        return Edge(here, _place(action.repair, action.slot, rule.stage, operators), f"repair {action.repair}")
    if isinstance(action, Exclude):
        if action.exclude not in operators:
            return Edge(here, ("probe", action.exclude), "exclude")
        return Edge(here, _place(action.exclude, None, rule.stage, operators), f"exclude {action.exclude}")
    if isinstance(action, Set):
        label = f"set {action.parameter} of {action.set}"
        return Edge(here, _place(action.set, None, rule.stage, operators), label)
    if isinstance(action, Adjust):
        label = f"adjust {action.parameter} of {action.adjust}"
        return Edge(here, _place(action.adjust, None, rule.stage, operators), label)
    raise TypeError(f"not an action: {action!r}")


def rule_graph(
    base: RuleBase, operators: Mapping[str, Operator], probes: Mapping[str, Probe], ids: Iterable[str] | None = None
) -> Graph:
    """Return the graph of a rule base, or of some of its rules with what they read and write.

    Parameters
    ----------
    base : RuleBase
    operators, probes : mappings
        For the slot of each operator, and the facts of each probe that a rule asks for.
    ids : iterable of str, optional
        The rules to show; all by default.
    """
    wanted = None if ids is None else set(ids)
    rules = [rule for rule in base.rules if wanted is None or rule.id in wanted]
    edges = set[Edge]()
    for rule in rules:
        edges |= _read(rule) | {_written(rule, action, operators) for action in rule.then}
    read = {edge.source[1] for edge in edges if edge.source[0] == "fact"}
    for name in sorted({edge.target[1] for edge in edges if edge.target[0] == "probe"}):
        probe = probes.get(name)
        templates = {model.template for model in probe.templates} if probe else set()
        edges |= {Edge(("probe", name), ("fact", template)) for template in templates & read}
    nodes = {Node("rule", rule.id, f"{rule.id} {rule.name}", rule.stage) for rule in rules}
    for kind, name in {end for edge in edges for end in (edge.source, edge.target)} - {("rule", r.id) for r in rules}:
        stage, _, slot = name.partition(".")
        if kind == "slot":
            nodes.add(Node(kind, name, slot, stage))
        else:
            nodes.add(Node(kind, name, "any finding" if name == EVERY_FINDING else name))
    return Graph(tuple(sorted(nodes)), tuple(sorted(edges)))


def _identifiers(graph: Graph) -> dict[tuple[Kind, str], str]:
    found: dict[tuple[Kind, str], str] = {}
    for node in graph.nodes:
        plain = f"{node.kind}_{re.sub(r'[^A-Za-z0-9]', '_', node.name)}"
        while plain in found.values():
            plain += "_"
        found[node.kind, node.name] = plain
    return found


def _quoted(text: str) -> str:
    return '"' + text.replace("#", "#35;").replace('"', "#quot;") + '"'


def as_mermaid(graph: Graph) -> str:
    """Write a graph as a Mermaid flowchart; dotted arrows stand for what must be absent."""
    names = _identifiers(graph)

    def line(node: Node) -> str:
        left, right = _SHAPES[node.kind]
        return f"{names[node.kind, node.name]}{left}{_quoted(node.label)}{right}"

    lines = ["flowchart LR"]
    lines += [f"  {line(node)}" for node in graph.nodes if not node.stage]
    for stage in STAGES:
        inside = [node for node in graph.nodes if node.stage == stage]
        if inside:
            lines += [f"  subgraph {stage}", *(f"    {line(node)}" for node in inside), "  end"]
    for edge in graph.edges:
        arrow = "-.->" if edge.negated else "-->"
        text = f"|{_quoted(edge.label)}|" if edge.label else ""
        lines.append(f"  {names[edge.source]} {arrow}{text} {names[edge.target]}")
    return "\n".join(lines) + "\n"
