"""What an evaluation shows: the systems side by side, per cause, against time, and where terrex loses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from expert.evaluate.store import Row
from expert.evaluate.table import Gap, Table, cross_validated

REGRETS = 20


@dataclass(frozen=True)
class SystemLine:
    """Means of one system over all cases; % unless the unit is in the name."""

    name: str
    kind: str
    bad_05: float
    bad_1: float
    bad_2: float
    wrong: float
    density: float
    epe_px: float
    cpu_s: float
    wall_s: float
    peak_mb: float
    failed: int
    facts_share: float | None
    inference_share: float | None
    dominated_by: str | None


@dataclass(frozen=True)
class Regret:
    """A case where a fixed configuration beats a system, and what the rules did there."""

    case: str
    system: str
    loss: float
    best: str
    best_loss: float
    findings: tuple[str, ...]
    plan: tuple[str, ...]
    rules: tuple[str, ...]


@dataclass(frozen=True)
class GapLine:
    """The closed gap of one system over some cases."""

    system: str
    cases: str
    count: int
    gap: Gap


@dataclass(frozen=True)
class Choice:
    """A choice among systems made on all scenes, and made without the scene that it is applied to."""

    among: str
    count: int
    training: float
    cross_validated: float


@dataclass(frozen=True)
class Summary:
    """Everything the terminal and the page show.

    `by_variant[system][variant]` is the mean bad-1 in %.
    """

    cases: int
    scenes: int
    systems: tuple[SystemLine, ...]
    variants: tuple[str, ...]
    by_variant: dict[str, dict[str, float]]
    gaps: tuple[GapLine, ...]
    choices: tuple[Choice, ...]
    regrets: tuple[Regret, ...]
    fired: dict[str, dict[str, int]]  # by rule and system, in how many cases


SUBSETS: tuple[tuple[str, Callable[[Row], bool]], ...] = (
    ("all", lambda row: True),
    ("clean, alike", lambda row: row.variant == "clean" and not row.differs),
    ("clean, differing by themselves", lambda row: row.variant == "clean" and row.differs),
    ("rendered", lambda row: row.pair.startswith("rendered/")),
)


def summarise(table: Table, candidates: Sequence[str] = ()) -> Summary:
    """Summarise a table.

    Parameters
    ----------
    table : Table
    candidates : sequence of str
        Systems among which a choice is to be made, e.g. variants of the rules.

    Raises
    ------
    ValueError
        The table is empty.
    """
    if not len(table):
        raise ValueError("no case has been run on all the systems")
    own = [name for name in table.systems if table.kinds[name] != "fixed"]
    by_variant = {variant: _of_variant(table, variant) for variant in table.variants}
    return Summary(
        len(table),
        len(np.unique(table.scenes)),
        tuple(_line(table, name) for name in table.systems),
        table.variants,
        {name: {v: part.mean("bad_1", name) for v, part in by_variant.items()} for name in table.systems},
        tuple(_gaps(table, own)),
        tuple(_choices(table, candidates)),
        tuple(regrets(table, [name for name in own if table.kinds[name] == "terrex"])),
        _fired(table, own),
    )


def _fired(table: Table, systems: Sequence[str]) -> dict[str, dict[str, int]]:
    """Count the cases in which each rule fired, the most frequent rules first."""
    found: dict[str, dict[str, int]] = {}
    for name in systems:
        at = table.systems.index(name)
        for rows in table.rows:
            for rule in rows[at].rules:
                counts = found.setdefault(rule, dict.fromkeys(systems, 0))
                counts[name] += 1
    return dict(sorted(found.items(), key=lambda item: (-max(item[1].values()), item[0])))


def _of_variant(table: Table, variant: str) -> Table:
    return table.where(lambda row: row.variant == variant)


def _line(table: Table, name: str) -> SystemLine:
    rows = [found[table.systems.index(name)] for found in table.rows]
    told = [row.shares for row in rows if row.shares]

    def mean(column: str) -> float:
        return table.mean(column, name)

    return SystemLine(
        name,
        table.kinds[name],
        bad_05=mean("bad_05"),
        bad_1=mean("bad_1"),
        bad_2=mean("bad_2"),
        wrong=mean("wrong"),
        density=mean("density"),
        epe_px=mean("epe_px"),
        cpu_s=mean("cpu_s"),
        wall_s=mean("wall_s"),
        peak_mb=mean("peak_mb"),
        failed=sum(row.failure is not None for row in rows),
        facts_share=float(np.mean([share["facts"] for share in told])) if told else None,
        inference_share=float(np.mean([share["inference"] for share in told])) if told else None,
        dominated_by=_dominating(table, name),
    )


def _dominating(table: Table, name: str) -> str | None:
    """Return a system of the other kind that is at least as accurate and as fast, the most accurate one."""
    loss, time = table.mean("bad_1", name), table.mean("cpu_s", name)
    better = [
        (table.mean("bad_1", other), other)
        for other in table.systems
        if (table.kinds[other] == "fixed") != (table.kinds[name] == "fixed")
        and table.mean("bad_1", other) <= loss
        and table.mean("cpu_s", other) <= time
    ]
    return min(better)[1] if better else None


def _gaps(table: Table, own: Sequence[str]) -> list[GapLine]:
    found = []
    for title, keep in SUBSETS:
        part = table.where(keep)
        if len(part) and part.fixed:
            found += [GapLine(name, title, len(part), part.gap(name)) for name in own]
    return found


def _choices(table: Table, candidates: Sequence[str]) -> list[Choice]:
    found = []
    for title, names in (("fixed configurations", table.fixed), ("candidate rules", tuple(candidates))):
        if len(names) > 1:
            losses = table.losses(names)
            held_out = cross_validated(losses, table.scenes)
            found.append(Choice(title, len(names), float(losses.mean(axis=0).min()), held_out))
    return found


def regrets(table: Table, systems: Sequence[str], most: int = REGRETS) -> list[Regret]:
    """Return the cases where a fixed configuration beats each system most, the worst first."""
    if not table.fixed:
        return []
    fixed = table.losses(table.fixed)
    found: list[Regret] = []
    for name in systems:
        own = table.losses([name])[:, 0]
        for index in np.argsort(fixed.min(axis=1) - own, kind="stable")[:most]:
            best = int(np.argmin(fixed[index]))
            row = table.rows[index][table.systems.index(name)]
            if own[index] > fixed[index, best]:
                found.append(
                    Regret(
                        row.case,
                        name,
                        float(own[index]),
                        table.fixed[best],
                        float(fixed[index, best]),
                        row.findings,
                        row.plan,
                        row.rules,
                    )
                )
    return found


def as_text(summary: Summary) -> str:
    """Write the summary for a terminal."""
    lines = [f"{summary.cases} cases of {summary.scenes} scenes; mean over the cases, missing counted as wrong", ""]
    names = ("bad-0.5", "bad-1", "bad-2", "wrong", "dense", "px", "CPU s", "MB")
    widths = (8, 7, 7, 7, 7, 6, 7, 6)
    lines.append(f"{'system':30s}" + "".join(f" {name:>{n}s}" for name, n in zip(names, widths, strict=True)))
    for line in sorted(summary.systems, key=lambda item: item.bad_1):
        lines.append(
            f"{line.name:30s} {line.bad_05:8.2f} {line.bad_1:7.2f} {line.bad_2:7.2f} {line.wrong:7.2f} "
            f"{line.density:7.1f} {line.epe_px:6.2f} {line.cpu_s:7.3f} {line.peak_mb:6.0f}"
            + (f"  facts {line.facts_share:.0%}, inference {line.inference_share:.1%}" if line.facts_share else "")
        )
    lines += ["", "mean bad-1 by distortion, %", f"{'system':30s}" + "".join(f" {v[:9]:>9s}" for v in summary.variants)]
    for name, by_variant in summary.by_variant.items():
        lines.append(f"{name:30s}" + "".join(f" {by_variant[v]:9.2f}" for v in summary.variants))
    lines += ["", "closed gap (0 the single best fixed configuration, 1 the best of them for every case)"]
    for item in summary.gaps:
        lines.append(f"{item.system:20s} {item.cases:32s} {item.count:5d} cases  {gap_text(item.gap)}")
    for choice in summary.choices:
        lines.append(
            f"choice among {choice.count} {choice.among}: {choice.training:.2f} % on all scenes, "
            f"{choice.cross_validated:.2f} % cross-validated by scene"
        )
    if summary.regrets:
        lines += ["", "where a fixed configuration is better most"]
        for regret in summary.regrets[:10]:
            lines.append(
                f"{regret.case:50s} {regret.system} {regret.loss:.1f} %, {regret.best} {regret.best_loss:.1f} %; "
                f"found {', '.join(regret.findings) or 'nothing'}"
            )
    return "\n".join(lines) + "\n"


def gap_text(gap: Gap) -> str:
    """Write a gap as a clause."""
    closed = "there is no gap" if gap.closed is None else f"closes {gap.closed:.2f}"
    between = f" [{gap.interval[0]:.2f}, {gap.interval[1]:.2f}]" if gap.interval and gap.closed is not None else ""
    return (
        f"{closed}{between}: {gap.loss:.2f} %, single best {gap.single_best_loss:.2f} ({gap.single_best}), "
        f"virtual best {gap.virtual_best_loss:.2f}"
    )
