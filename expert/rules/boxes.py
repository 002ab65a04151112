"""Boxes with lines of text and arrows between them: sizes, places and paths of a drawing, in px."""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from expert.rules.layout import layered

CHARACTER = 6.6  # of 12 px sans-serif, on average
LINE = 15.0
MARGIN, COLUMN_GAP = 16.0, 90.0
NodeT = TypeVar("NodeT", bound=Hashable)


@dataclass(frozen=True)
class Box:
    """A box: left side, middle, width, height, and its column."""

    x: float
    y: float
    width: float
    height: float
    column: int


@dataclass(frozen=True)
class Placed(Generic[NodeT]):
    """Where everything is.

    Attributes
    ----------
    boxes : dict
        Box of each node.
    paths : tuple of str
        For each edge what stands in `d` of its SVG path.
    width, height : float
        Of the whole, with margins.
    """

    boxes: Mapping[NodeT, Box]
    paths: tuple[str, ...]
    width: float
    height: float


def place(
    texts: Mapping[NodeT, Sequence[str]],
    edges: Sequence[tuple[NodeT, NodeT]],
    top: float = MARGIN,
    column_gap: float = COLUMN_GAP,
    late: bool = False,
    character: float = CHARACTER,
) -> Placed[NodeT]:
    """Lay out boxes in columns, from left to right along the edges.

    Parameters
    ----------
    texts : dict
        Lines of each node.
    edges : sequence of (source, target)
    top, column_gap : float
        Space above the boxes and between the columns.
    late : bool
        Whether a node that nothing leads to stands just before what it leads to, instead of in the first column.
    character : float
        Mean width of a character.
    """
    heights = {node: 8.0 + LINE * len(lines) for node, lines in texts.items()}
    wide = {node: 16.0 + character * max(map(len, lines), default=0) for node, lines in texts.items()}
    found = layered(heights, edges, late=late)
    columns = max(found.column.values(), default=-1) + 1
    widths = [max(wide[node] for node, at in found.column.items() if at == column) for column in range(columns)]
    lefts = [MARGIN + sum(widths[:column]) + column_gap * column for column in range(columns)]
    boxes = {
        node: Box(lefts[column], top + found.y[node], wide[node], heights[node], column)
        for node, column in found.column.items()
    }
    paths = []
    for index, (source, target) in enumerate(edges):
        one, two = boxes[source], boxes[target]
        step = 1 if two.column >= one.column else -1
        points = [(one.x + (one.width if step > 0 else 0), one.y)]
        points.append((lefts[one.column] + (widths[one.column] if step > 0 else 0), one.y))  # past wider boxes
        for number, height in enumerate(found.bends[index], start=1):
            column = one.column + step * number
            ends = (lefts[column], lefts[column] + widths[column])
            points += [(x, top + height) for x in (ends if step > 0 else ends[::-1])]
        points.append((two.x - 2 if step > 0 else two.x + two.width + 2, two.y))
        paths.append(curve(points))
    width = (lefts[-1] + widths[-1] if columns else 0.0) + MARGIN
    height = max((box.y + box.height / 2 for box in boxes.values()), default=top) + MARGIN
    return Placed(boxes, tuple(paths), width, height)


def curve(points: Sequence[tuple[float, float]]) -> str:
    """Return a smooth path through points that goes flat through each."""
    path = f"M{points[0][0]:.0f},{points[0][1]:.1f}"
    for (x0, y0), (x1, y1) in itertools.pairwise(points):
        middle = (x0 + x1) / 2
        path += f"C{middle:.0f},{y0:.1f} {middle:.0f},{y1:.1f} {x1:.0f},{y1:.1f}"
    return path
