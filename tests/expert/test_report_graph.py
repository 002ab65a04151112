"""The decision graph: every firing and every loser is in it, and everything that led to a choice leads to it."""

from __future__ import annotations

import numpy as np
import pytest

from expert.api import ExpertSystem
from expert.decision import Decision
from expert.explain import rules_of
from expert.pair import StereoPair
from expert.report.graph import DecisionGraph, decision_graph, draw


@pytest.fixture(scope="module")
def decision() -> Decision:
    """Return a decision about a pair whose right image is darker and moved, so that rules of all kinds fire."""
    rng = np.random.default_rng(7)
    left = np.kron(rng.integers(60, 220, (60, 80), dtype=np.uint8), np.ones((4, 4), np.uint8))
    right = np.roll(left, -6, axis=1)
    return ExpertSystem().decide(StereoPair(left, (right * 0.7).astype(np.uint8)))


@pytest.fixture(scope="module")
def graph(decision: Decision) -> DecisionGraph:
    return decision_graph(decision, rules_of(decision))


def test_every_rule_that_fired_every_finding_and_every_loser_has_a_box(
    decision: Decision, graph: DecisionGraph
) -> None:
    keys = {node.key for node in graph.nodes}
    assert {("rule", f"{firing.stage} {firing.rule}") for firing in decision.firings} <= keys
    assert {("finding", finding.name) for finding in decision.findings} <= keys
    for stage, plan in decision.plans.items():
        for step in plan.steps:
            slot = f"{stage}.{step.slot}"
            if step.chosen_by:
                assert ("choice", f"{slot} {step.operator}") in keys
            for loser in step.losers:
                assert loser.rule is None or ("lost", f"{slot} {loser.operator}") in keys


def test_edges_join_boxes_and_lead_from_the_rule_to_what_it_chose(decision: Decision, graph: DecisionGraph) -> None:
    keys = {node.key for node in graph.nodes}
    joined = {(edge.source, edge.target) for edge in graph.edges}
    assert len(joined) == len(graph.edges)
    assert all(end in keys for pair in joined for end in pair)
    chosen = [(stage, step) for stage, plan in decision.plans.items() for step in plan.steps if step.chosen_by]
    assert chosen
    for stage, step in chosen:
        target = ("choice", f"{stage}.{step.slot} {step.operator}")
        assert any(one[0] == "rule" and str(step.chosen_by) in one[1] and two == target for one, two in joined)


def test_what_darkened_the_image_leads_to_the_choice_that_answers_it(graph: DecisionGraph) -> None:
    into: dict[object, set[object]] = {}
    for edge in graph.edges:
        into.setdefault(edge.target, set()).add(edge.source)
    answer = next(
        node.key for node in graph.nodes if node.key[0] == "choice" and "correction.radiometry" in node.key[1]
    )
    before, todo = set(), [answer]
    while todo:
        for source in into.get(todo.pop(), set()) - before:
            before.add(source)
            todo.append(source)
    kinds = {key[0] for key in before}
    assert {"fact", "rule", "finding"} <= kinds
    assert ("finding", "exposure-differs") in before


def test_what_rules_asked_to_be_measured_follows_them(decision: Decision, graph: DecisionGraph) -> None:
    asked = {
        (f"{firing.stage} {firing.rule}", action.text.removeprefix("measure "))
        for firing in decision.firings
        for action in firing.actions
        if action.kind == "measure"
    }
    measured = {record.probe for record in decision.facts}
    told = {
        (edge.source[1], edge.label.removeprefix("asked for ")) for edge in graph.edges if "asked for" in edge.label
    }
    assert {pair for pair in asked if pair[1] in measured} == told
    assert told


def test_the_graph_needs_no_rules_and_is_the_same_for_the_record_read_back(decision: Decision) -> None:
    again = Decision.from_json(decision.to_json())
    assert decision_graph(again, rules_of(again)) == decision_graph(decision, rules_of(decision))
    assert {node.key for node in decision_graph(decision).nodes} == {
        node.key for node in decision_graph(again, rules_of(again)).nodes
    }


def test_boxes_do_not_overlap_and_facts_stand_before_their_rules(graph: DecisionGraph) -> None:
    drawing = draw(graph, {})
    boxes = [node.box for node in drawing.nodes]
    for index, one in enumerate(boxes):
        for two in boxes[index + 1 :]:
            assert one.column != two.column or abs(one.y - two.y) >= (one.height + two.height) / 2
    column = {node.number: node.box.column for node in drawing.nodes}
    facts = {node.number for node in drawing.nodes if node.kind == "fact"}
    assert all(column[edge.source] < column[edge.target] for edge in drawing.edges if edge.source in facts)
    assert max(box.x + box.width for box in boxes) <= drawing.width
