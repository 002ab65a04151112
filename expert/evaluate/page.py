"""The summary of an evaluation as one self-contained page with sortable tables and an error-time plot."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from expert.evaluate.ablation import RuleEffect
from expert.evaluate.summary import Summary, SystemLine, gap_text
from expert.pages import render

WIDTH, HEIGHT, MARGIN = 900, 420, 60
LETTER_PX, LINE_PX = 6.4, 13.0  # of a label of 12 px
Box = tuple[float, float, float, float]  # left, top, right, bottom


@dataclass(frozen=True)
class Mark:
    """One system in the plot of error against time, in user units of the picture."""

    name: str
    kind: str
    x: float
    y: float
    title: str
    label: tuple[float, float] | None = None  # where its name begins; None where there is no room for it


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
    top = max(line.bad_1 for line in lines) * 1.05 or 1.0  # all may be right

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
        )
        for line in lines
    )
    named = {line.name for line in lines if line in front or line.kind != "fixed"}
    seconds = [s * 10.0**e for e in range(-4, 3) for s in (1, 2, 5) if low <= math.log10(s * 10.0**e) <= high]
    step = 10 ** math.floor(math.log10(top)) / (1 if top / 10 ** math.floor(math.log10(top)) > 4 else 2)
    percents = [i * step for i in range(int(top / step) + 1)]
    corners = [f"{x(front[0].cpu_s)},{y(front[0].bad_1)}"]
    for one, two in pairwise(front):
        corners += [f"{x(two.cpu_s)},{y(one.bad_1)}", f"{x(two.cpu_s)},{y(two.bad_1)}"]
    return Plot(
        labelled(marks, named),
        tuple(Tick(x(s), f"{s:g} s") for s in seconds),
        tuple(Tick(y(p), f"{p:g} %") for p in percents),
        " ".join(corners),
    )


def labelled(marks: Sequence[Mark], named: Collection[str]) -> tuple[Mark, ...]:
    """Give the marks that have a name a place for it beside them, where no other mark or name is."""
    taken: list[Box] = [(mark.x - 5, mark.y - 5, mark.x + 5, mark.y + 5) for mark in marks]
    placed = {}
    for mark in sorted(marks, key=lambda item: (item.kind == "fixed", item.y)):
        if mark.name in named:
            placed[mark.name] = _free_place(mark, taken)
    return tuple(replace(mark, label=placed.get(mark.name)) for mark in marks)


def _free_place(mark: Mark, taken: list[Box]) -> tuple[float, float] | None:
    """Return where a name can begin, and take that place: beside the mark, else above or below it, else nowhere."""
    length = LETTER_PX * len(mark.name)
    for line in (0, -1, 1, -2, 2, -3, 3, -4, 4):
        for left in (mark.x + 9, mark.x - 9 - length):
            middle = mark.y + line * LINE_PX
            box = (left, middle - LINE_PX / 2, left + length, middle + LINE_PX / 2)
            inside = box[0] >= MARGIN and box[2] <= WIDTH and box[1] >= MARGIN / 2 and box[3] <= HEIGHT - MARGIN
            if inside and not any(_meet(box, other) for other in taken):
                taken.append(box)
                return round(left, 1), round(middle + 4, 1)
    return None


def _meet(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


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
