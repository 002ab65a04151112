from __future__ import annotations

import random
import xml.etree.ElementTree as ElementTree

import pytest

from expert.facts import vocabulary
from expert.rules.drawing import as_svg
from expert.rules.graph import rule_graph
from expert.rules.layout import layered
from expert.rules.load import load_rules
from modules.catalog import operators, probes

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def shipped():
    return load_rules(None, vocabulary(probes().values()), operators(), probes()).base


def test_the_drawing_is_xml_and_shows_every_rule_and_every_edge(shipped):
    root = ElementTree.fromstring(as_svg(shipped, vocabulary(probes().values()), operators(), probes()))
    texts = {text.text for text in root.iter(f"{SVG}text")}
    assert {rule.id for rule in shipped.rules} <= texts
    assert {"measurement", "correction", "matching", "reconstruction"} <= texts
    told = {title.text for title in root.iter(f"{SVG}title")}
    assert any("COR010" in text and "asks for exposure-differs" in text for text in told)
    wanted = 0
    for stage in ("measurement", "correction", "matching", "reconstruction"):
        graph = rule_graph(shipped, operators(), probes(), [rule.id for rule in shipped.of_stage(stage)])
        wanted += sum(edge.source[0] != "probe" for edge in graph.edges)
    assert sum(group.get("class") == "edge" for group in root.iter(f"{SVG}g")) == wanted


def test_the_drawing_is_the_same_every_time(shipped):
    known = (vocabulary(probes().values()), operators(), probes())
    assert as_svg(shipped, *known) == as_svg(shipped, *known)


def test_a_drawing_of_no_rules_is_a_drawing(shipped):
    root = ElementTree.fromstring(as_svg(shipped, {}, operators(), probes(), []))
    assert not list(root.iter(f"{SVG}text"))


def random_graph(seed):
    source = random.Random(seed)
    nodes = [f"n{index}" for index in range(source.randint(1, 25))]
    edges = [(source.choice(nodes), source.choice(nodes)) for _ in range(source.randint(0, 40))]
    return {node: source.choice([20.0, 38.0]) for node in nodes}, [(one, two) for one, two in edges if one != two]


@pytest.mark.parametrize("seed", range(30))
def test_boxes_of_one_column_keep_their_distance_and_edges_lead_to_the_right(seed):
    heights, edges = random_graph(seed)
    placed = layered(heights, edges, gap=10)
    for one in heights:
        for two in heights:
            if one < two and placed.column[one] == placed.column[two]:
                apart = abs(placed.y[one] - placed.y[two])
                assert apart >= (heights[one] + heights[two]) / 2 + 10 - 1e-6
    for index, (one, two) in enumerate(edges):
        assert placed.column[one] != placed.column[two]
        assert len(placed.bends[index]) == abs(placed.column[one] - placed.column[two]) - 1
    assert min(placed.y[node] - heights[node] / 2 for node in heights) >= -1e-6


def test_a_chain_is_drawn_as_one_straight_line():
    placed = layered({"a": 20.0, "b": 20.0, "c": 20.0}, [("a", "b"), ("b", "c")])
    assert [placed.column[name] for name in "abc"] == [0, 1, 2]
    assert placed.y["a"] == placed.y["b"] == placed.y["c"] == 10.0


def test_two_columns_that_need_not_cross_do_not():
    heights = dict.fromkeys(("a", "b", "c", "x", "y", "z"), 20.0)
    placed = layered(heights, [("a", "z"), ("b", "y"), ("c", "x")])
    assert [sorted("abc", key=placed.y.get), sorted("xyz", key=placed.y.get)] == [["a", "b", "c"], ["z", "y", "x"]]


def test_late_nodes_stand_just_before_what_they_lead_to():
    edges = [("a", "b"), ("b", "c"), ("late", "c")]
    heights = dict.fromkeys(["a", "b", "c", "late"], 10.0)
    assert layered(heights, edges).column["late"] == 0
    assert layered(heights, edges, late=True).column == {"a": 0, "b": 1, "c": 2, "late": 1}
