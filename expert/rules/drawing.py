"""Draw the graph of a rule base as SVG: one band per stage, from what rules read to what they write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.sax.saxutils import escape

from expert.facts import Vocabulary
from expert.rules.boxes import MARGIN, Box, place
from expert.rules.explain import sentence
from expert.rules.graph import Edge, Graph, Kind, Node, rule_graph
from expert.rules.model import STAGES, RuleBase
from modules.operator import Operator
from modules.probe import Probe

TITLE = 34.0  # px
_FILLS: Mapping[Kind, str] = {
    "fact": "#e8eef7", "finding": "#fdf0d5", "rule": "#ffffff", "slot": "#dff0e0", "probe": "#efe6f5",
}  # fmt: skip
_LINES = (
    ("exclude", "#b3261e"), ("repair", "#b3261e"), ("adjust", "#a05a00"), ("set", "#a05a00"), ("choose", "#2e7d32"),
    ("derive", "#8a6d1f"), ("assess", "#8a6d1f"), ("measure", "#6a4c8c"),
)  # fmt: skip
_STYLE = "g.edge:hover path{stroke-width:3}"


def _lines(node: Node, probes: Mapping[str, Probe]) -> tuple[str, ...]:
    if node.kind == "rule":
        return node.name, node.label.removeprefix(f"{node.name} ")
    if node.kind == "probe" and node.name in probes:
        return node.name, "gives " + ", ".join(model.template for model in probes[node.name].templates)
    return (f"{node.stage}.{node.label}" if node.kind == "slot" else node.label,)


def _colour(edge: Edge) -> str:
    if edge.negated:
        return "#b3261e"
    return next((colour for verb, colour in _LINES if edge.label.startswith(verb)), "#7b8aa0")


def _said(edge: Edge) -> str:
    source, target = edge.source[1], edge.target[1]
    if edge.target[0] == "rule":
        return f"{target} asks {'for the absence of' if edge.negated else 'for'} {source}" + (
            f": {edge.label}" if edge.label else ""
        )
    return f"{source}: {edge.label or target}"


def _band(
    title: str, graph: Graph, told: Mapping[str, str], probes: Mapping[str, Probe]
) -> tuple[list[str], float, float]:
    """Return the drawing of one stage, its width and its height."""
    edges = [edge for edge in graph.edges if edge.source[0] != "probe"]  # the box of a probe says what it gives
    texts = {(node.kind, node.name): _lines(node, probes) for node in graph.nodes}
    placed = place(texts, [(edge.source, edge.target) for edge in edges], TITLE)
    drawn = [f'<text font-size="16" font-weight="bold" x="{MARGIN:.0f}" y="20">{escape(title)}</text>']
    for edge, path in zip(edges, placed.paths, strict=True):
        absent = ' stroke-dasharray="5 3"' if edge.negated else ""
        drawn.append(
            f'<g class="edge"><title>{escape(_said(edge))}</title>'
            f'<path{absent} fill="none" stroke-width="1.3" stroke="{_colour(edge)}" '
            f'marker-end="url(#arrow)" d="{path}"/></g>'
        )
    for node in graph.nodes:
        drawn.append(_drawn_box(node, placed.boxes[node.kind, node.name], texts[node.kind, node.name], told))
    return drawn, placed.width, placed.height


def _drawn_box(node: Node, box: Box, texts: Sequence[str], told: Mapping[str, str]) -> str:
    top = box.y - box.height / 2
    round_ = {"finding": 12, "slot": 12}.get(node.kind, 2)
    hover = told.get(node.name, "") if node.kind == "rule" else f"{node.kind} {node.name}"
    lines = "".join(
        f'<text x="{box.x + 8:.0f}" y="{top + 16 + 15 * index:.1f}" fill="{"#555555" if index else "#1c1c1c"}">'
        f"{escape(text)}</text>"
        for index, text in enumerate(texts)
    )
    return (
        f"<g><title>{escape(hover)}</title>"
        f'<rect x="{box.x:.0f}" y="{top:.1f}" width="{box.width:.0f}" height="{box.height:.0f}" rx="{round_}" '
        f'fill="{_FILLS[node.kind]}" stroke="#888888"/>{lines}</g>'
    )


def as_svg(
    base: RuleBase,
    vocabulary: Vocabulary,
    operators: Mapping[str, Operator],
    probes: Mapping[str, Probe],
    ids: Sequence[str] | None = None,
) -> str:
    """Draw rules with what they read and write.

    Boxes and arrows carry a sentence that viewers show under the pointer; dashed arrows stand for what must be absent.

    Parameters
    ----------
    base : RuleBase
    vocabulary, operators, probes : mappings
        For units, slots and measured facts.
    ids : sequence of str, optional
        The rules to show; all by default.
    """
    told = {rule.id: sentence(rule, vocabulary, base.thresholds) for rule in base.rules}
    bands: list[str] = []
    width, height = 0.0, MARGIN
    for stage in STAGES:
        wanted = [rule.id for rule in base.of_stage(stage) if ids is None or rule.id in ids]
        if wanted:
            drawn, wide, high = _band(stage, rule_graph(base, operators, probes, wanted), told, probes)
            bands.append(f'<g transform="translate(0,{height:.0f})">' + "\n".join(drawn) + "</g>")
            width, height = max(width, wide), height + high + MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}">\n<style>{_STYLE}</style>\n'
        '<defs><marker id="arrow" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0,0L8,4L0,8z" fill="#666666"/></marker></defs>\n'
        f'<rect width="100%" height="100%" fill="#ffffff"/>\n'
        + '<g font-family="sans-serif" font-size="12">\n'
        + "\n".join(bands)
        + "\n</g></svg>\n"
    )
