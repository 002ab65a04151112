"""Layered layout of a directed graph: columns by longest path, few crossings, short edges.

References
----------
Sugiyama, Tagawa & Toda, "Methods for Visual Understanding of Hierarchical System Structures", IEEE Trans. Systems, Man
and Cybernetics, 1981: layers, dummy nodes on long edges, ordering by barycentres.
"""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

SWEEPS = 12
NodeT = TypeVar("NodeT", bound=Hashable)


@dataclass(frozen=True)
class Layout(Generic[NodeT]):
    """Where everything is.

    Attributes
    ----------
    column : dict
        Column of each node, from 0.
    y : dict
        Centre of each node.
    bends : dict
        For each edge, by its place in the list of edges, the heights at which it passes the columns between its ends.
    """

    column: Mapping[NodeT, int]
    y: Mapping[NodeT, float]
    bends: Mapping[int, tuple[float, ...]]


def layered(
    heights: Mapping[NodeT, float],
    edges: Sequence[tuple[NodeT, NodeT]],
    gap: float = 10.0,
    lane: float = 4.0,
    late: bool = False,
) -> Layout[NodeT]:
    """Lay out a graph from left to right.

    Parameters
    ----------
    heights : dict
        Height of each node; its order settles what nothing else does.
    edges : sequence of (source, target)
        Edges that close a circle are drawn, but do not count for the columns.
    gap, lane : float
        Least distance of nodes, and the height that a passing edge takes.
    late : bool
        Whether a node that no edge leads to stands just before what it leads to, instead of in the first column.
    """
    column = _columns(list(heights), edges)
    if late:
        _delay(column, edges)
    graph = _Proper(column, heights, edges, lane)
    graph.order()
    y = graph.place(gap)
    bends = {index: tuple(y[point] for point in chain[1:-1]) for index, chain in graph.chains.items()}
    return Layout(column, {node: y[node] for node in heights}, bends)


def _columns(nodes: Sequence[NodeT], edges: Sequence[tuple[NodeT, NodeT]]) -> dict[NodeT, int]:
    """Return the longest path to each node, once the edges that close circles are left out."""
    targets: dict[NodeT, list[NodeT]] = {node: [] for node in nodes}
    for source, target in edges:
        targets[source].append(target)
    state: dict[NodeT, int] = {}
    finished: list[NodeT] = []
    forward: list[tuple[NodeT, NodeT]] = []
    for root in nodes:
        stack = [(root, iter(targets[root]))] if root not in state else []
        state.setdefault(root, 1)
        while stack:
            node, following = stack[-1]
            for target in following:
                if state.get(target) == 1:  # on the path that leads here
                    continue
                forward.append((node, target))
                if target not in state:
                    state[target] = 1
                    stack.append((target, iter(targets[target])))
                    break
            else:
                stack.pop()
                state[node] = 2
                finished.append(node)
    column = dict.fromkeys(nodes, 0)
    following_of: dict[NodeT, list[NodeT]] = {node: [] for node in nodes}
    for source, target in forward:
        following_of[source].append(target)
    for node in reversed(finished):
        for target in following_of[node]:
            column[target] = max(column[target], column[node] + 1)
    return column


def _delay(column: dict[NodeT, int], edges: Sequence[tuple[NodeT, NodeT]]) -> None:
    """Move the nodes that no edge leads to next to what they lead to."""
    reached = {target for _, target in edges}
    nearest: dict[NodeT, int] = {}
    for source, target in edges:
        if source not in reached:
            nearest[source] = min(nearest.get(source, column[target]), column[target])
    column.update({node: max(0, first - 1) for node, first in nearest.items()})


class _Proper:
    """The graph with a point in every column that an edge passes."""

    def __init__(
        self,
        column: Mapping[NodeT, int],
        heights: Mapping[NodeT, float],
        edges: Sequence[tuple[NodeT, NodeT]],
        lane: float,
    ) -> None:
        self.layers: list[list[Hashable]] = [[] for _ in range(max(column.values(), default=-1) + 1)]
        self.height: dict[Hashable, float] = {node: height for node, height in heights.items()}  # noqa: C416
        self.near: dict[Hashable, tuple[list[Hashable], list[Hashable]]] = {node: ([], []) for node in heights}
        self.chains: dict[int, list[Hashable]] = {}
        for node in heights:
            self.layers[column[node]].append(node)
        for index, (source, target) in enumerate(edges):
            first, last = column[source], column[target]
            step = 1 if last >= first else -1
            points: list[Hashable] = [source]
            for where in range(first + step, last, step):
                point = (index, where)
                self.layers[where].append(point)
                self.height[point] = lane
                self.near[point] = ([], [])
                points.append(point)
            points.append(target)
            self.chains[index] = points
            for one, two in itertools.pairwise(points):
                left, right = (one, two) if step > 0 else (two, one)
                self.near[left][1].append(right)
                self.near[right][0].append(left)

    def order(self) -> None:
        """Order each column by the mean place of the neighbours, to and fro."""
        place = {node: float(index) for layer in self.layers for index, node in enumerate(layer)}
        for sweep in range(SWEEPS):
            side = sweep % 2  # 0: by the column to the left, going right
            for layer in self.layers if side == 0 else reversed(self.layers):
                centre = {
                    node: sum(place[other] for other in self.near[node][side]) / len(self.near[node][side])
                    if self.near[node][side]
                    else place[node]
                    for node in layer
                }
                layer.sort(key=lambda node, centre=centre: centre[node])  # type: ignore[misc]
                place.update({node: float(index) for index, node in enumerate(layer)})

    def place(self, gap: float) -> dict[Hashable, float]:
        """Give every node the height nearest to its neighbours that keeps order and distance."""
        y: dict[Hashable, float] = {}
        for layer in self.layers:
            y.update(_spread(layer, [0.0] * len(layer), self.height, gap))
        for sweep in range(SWEEPS):
            for layer in self.layers if sweep % 2 == 0 else reversed(self.layers):
                wanted = []
                for node in layer:
                    others = [*self.near[node][0], *self.near[node][1]]
                    wanted.append(sum(y[other] for other in others) / len(others) if others else y[node])
                y.update(_spread(layer, wanted, self.height, gap))
        top = min((y[node] - self.height[node] / 2 for node in y), default=0.0)
        return {node: value - top for node, value in y.items()}


def _spread(
    layer: Sequence[Hashable], wanted: Sequence[float], height: Mapping[Hashable, float], gap: float
) -> dict[Hashable, float]:
    """Return the heights nearest to the wanted ones, in this order and without overlap (pool adjacent violators)."""
    offsets: list[float] = []
    for index, node in enumerate(layer):
        before = layer[index - 1] if index else node
        offsets.append(offsets[-1] + (height[before] + height[node]) / 2 + gap if index else 0.0)
    blocks: list[list[float]] = []  # sum and count of what each block wants
    for value, offset in zip(wanted, offsets, strict=True):
        blocks.append([value - offset, 1])
        while len(blocks) > 1 and blocks[-2][0] / blocks[-2][1] > blocks[-1][0] / blocks[-1][1]:
            total, count = blocks.pop()
            blocks[-1][0] += total
            blocks[-1][1] += count
    means = [total / count for total, count in blocks for _ in range(int(count))]
    return {node: mean + offset for node, mean, offset in zip(layer, means, offsets, strict=True)}
