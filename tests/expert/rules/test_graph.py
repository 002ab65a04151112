from __future__ import annotations

import re

import pytest

from expert.facts import vocabulary
from expert.rules.graph import Edge, as_mermaid, rule_graph
from expert.rules.load import load_rules
from expert.rules.model import RuleBase
from modules.catalog import operators, probes


def rule(number, when, then):
    return {
        "id": f"COR{number:03d}",
        "name": f"rule-{number}",
        "stage": "correction",
        "when": when,
        "then": then,
        "because": "it is needed for a test",
        "references": ["test"],
    }


def graph(*rules):
    return rule_graph(RuleBase(rules=list(rules)), operators(), probes())


def test_a_rule_is_reached_from_its_facts_and_findings_and_leads_to_what_it_writes():
    found = graph(
        rule(
            1,
            [{"fact": "task", "field": "profile", "op": "eq", "value": "fast"}, {"not": {"finding": "noisy"}}],
            [{"derive": "slow"}, {"choose": "correction.match_histograms"}, {"choose": "none", "slot": "masks"}],
        )
    )
    here = ("rule", "COR001")
    assert set(found.edges) == {
        Edge(("fact", "task"), here, "profile"),
        Edge(("finding", "noisy"), here, "", True),
        Edge(here, ("finding", "slow"), "derive"),
        Edge(here, ("slot", "correction.radiometry"), "choose correction.match_histograms"),
        Edge(here, ("slot", "correction.masks"), "choose none"),
    }
    assert {(node.kind, node.name) for node in found.nodes} == {
        end for edge in found.edges for end in (edge.source, edge.target)
    }


def test_a_probe_that_is_asked_for_leads_to_the_facts_that_are_read():
    found = graph(
        rule(1, [{"fact": "task"}], [{"measure": "measurement.disparity_range"}]),
        rule(2, [{"fact": "disparity_range"}], [{"derive": "slow"}]),
    )
    assert Edge(("probe", "measurement.disparity_range"), ("fact", "disparity_range")) in found.edges


def test_names_that_differ_in_punctuation_only_stay_apart():
    found = graph(rule(1, [{"fact": "task"}], [{"derive": "a-b"}, {"derive": "a_b"}]))
    text = as_mermaid(found)
    assert re.findall(r'(\w+)\{\{"a[-_]b"\}\}', text) == ["finding_a_b", "finding_a_b_"]


@pytest.fixture(scope="module")
def shipped():
    return load_rules(None, vocabulary(probes().values()), operators(), probes())


def test_every_arrow_of_the_shipped_rules_joins_declared_nodes_once(shipped):
    text = as_mermaid(rule_graph(shipped.base, operators(), probes()))
    lines = text.splitlines()
    assert lines[0] == "flowchart LR"
    declared = [match[1] for line in lines if (match := re.match(r'\s+(\w+)[\[({/]+".*"[\])}/]+$', line))]
    assert len(declared) == len(set(declared))
    arrows = [match for line in lines if (match := re.match(r"  (\w+) -\.?->(?:\|.*\|)? (\w+)$", line))]
    assert {end for match in arrows for end in match.groups()} == set(declared)
    blocks = sum(line.startswith("  subgraph") for line in lines)
    assert len(lines) == 1 + len(declared) + len(arrows) + 2 * blocks
    assert {rule.id for rule in shipped.base.rules} <= {name.removeprefix("rule_") for name in declared}
