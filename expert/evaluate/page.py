"""The summary of an evaluation as one self-contained page with sortable tables and an error-time plot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from expert.evaluate.ablation import RuleEffect
from expert.evaluate.summary import Summary, SystemLine, gap_text
from expert.pages import render

WIDTH, HEIGHT, MARGIN = 900, 420, 60


@dataclass(frozen=True)
class Mark:
    """One system in the plot of error against time, in user units of the picture."""

    name: str
    kind: str
    x: float
    y: float
    title: str
    best: bool


@dataclass(frozen=True)
class Tick:
    """One line of the grid."""

    at: float
    label: str


@dataclass(frozen=True)
class Plot:
    """Error against CPU time, the time on a logarithmic scale."""

    marks: tuple[Mark, ...]
    across: tuple[Tick, ...]
    up: tuple[Tick, ...]
    front: str
    width: int = WIDTH
    height: int = HEIGHT


def pareto_front(lines: Sequence[SystemLine]) -> list[SystemLine]:
    """Return the systems that no other one beats in both error and CPU time, the fastest first."""
    front: list[SystemLine] = []
    for line in sorted(lines, key=lambda item: (item.cpu_s, item.bad_1)):
        if not front or line.bad_1 < front[-1].bad_1:
            front.append(line)
    return front


def plot(lines: Sequence[SystemLine]) -> Plot:
    """Lay the plot out."""
    front = pareto_front(lines)
    times = [max(line.cpu_s, 1e-4) for line in lines]
    low, high = math.log10(min(times)) - 0.1, math.log10(max(times)) + 0.1
    top = max(line.bad_1 for line in lines) * 1.05

    def x(seconds: float) -> float:
        return round(MARGIN + (math.log10(max(seconds, 1e-4)) - low) / (high - low) * (WIDTH - 2 * MARGIN), 1)

    def y(percent: float) -> float:
        return round(HEIGHT - MARGIN - percent / top * (HEIGHT - 2 * MARGIN), 1)

    marks = tuple(
        Mark(
            line.name,
            line.kind,
            x(line.cpu_s),
            y(line.bad_1),
            f"{line.name}: {line.bad_1:.2f} % at {line.cpu_s:.3f} s",
            line in front,
        )
        for line in lines
    )
    seconds = [s * 10.0**e for e in range(-4, 3) for s in (1, 2, 5) if low <= math.log10(s * 10.0**e) <= high]
    step = 10 ** math.floor(math.log10(top)) / (1 if top / 10 ** math.floor(math.log10(top)) > 4 else 2)
    percents = [i * step for i in range(int(top / step) + 1)]
    corners = [f"{x(front[0].cpu_s)},{y(front[0].bad_1)}"]
    for one, two in pairwise(front):
        corners += [f"{x(two.cpu_s)},{y(one.bad_1)}", f"{x(two.cpu_s)},{y(two.bad_1)}"]
    return Plot(
        marks,
        tuple(Tick(x(s), f"{s:g} s") for s in seconds),
        tuple(Tick(y(p), f"{p:g} %") for p in percents),
        " ".join(corners),
    )


def as_html(summary: Summary, effects: Sequence[RuleEffect] = ()) -> str:
    """Return the page; it needs no other file and no network, and names from files appear as text."""
    return render(
        "expert.evaluate",
        "evaluation.html.j2",
        summary=summary,
        effects=effects,
        plot=plot(summary.systems),
        gap=gap_text,
    )
