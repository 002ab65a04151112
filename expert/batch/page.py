"""The page of a batch: all pairs, the rules that fired, facts over the sequence, outliers; from the log alone."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from expert.batch.item import natural
from expert.batch.runlog import NAME, RunLog
from expert.pages import render
from modules.formats._text import write_text

PAGE = "index.html"
OUTLIER = 5.0  # robust standard deviations from the median of the batch
MOST_OUTLIERS = 50
FEWEST_PAIRS = 8  # below this a spread says little
TREND = 3.0  # robust standard deviations over the batch, from which a fact that is not watched is shown, too
MOST_DRIFTS = 30
WIDTH, HEIGHT = 320, 56
WATCHED = (  # facts whose drift over a sequence tells of cameras that change
    "brightness.mean_difference_dn",
    "brightness.gain",
    "noise.left_sigma_dn",
    "noise.right_sigma_dn",
    "sharpness.ratio",
    "row_alignment.offset_px",
    "disparity_range[estimated, positive].max_px",
    "disparity_quality.density_fraction",
    "disparity_quality.score",
)


@dataclass(frozen=True)
class PairLine:
    """One row of the table of pairs."""

    name: str
    status: str
    reason: str
    score: float | None
    seconds: float
    rules: str
    report: str
    thumbnail: str


@dataclass(frozen=True)
class Mark:
    """An outlier in the course of a fact."""

    x: float
    y: float
    text: str


@dataclass(frozen=True)
class Drift:
    """One fact over the pairs in the order of their names.

    Attributes
    ----------
    points : str
        Of an SVG polyline.
    middle : float
        Height of the median in the picture.
    marks : tuple of Mark
        The outliers.
    slope : float
        Change over the whole batch in robust standard deviations.
    """

    fact: str
    least: float
    median: float
    most: float
    points: str
    middle: float
    marks: tuple[Mark, ...]
    slope: float


@dataclass(frozen=True)
class Outlier:
    """A fact of one pair far from the rest of the batch."""

    pair: str
    fact: str
    value: float
    median: float
    deviations: float


@dataclass(frozen=True)
class RuleCount:
    """How many pairs a rule fired for; without a name where no record of such a pair was kept."""

    rule: str
    name: str
    pairs: int
    percent: float


def _pairs(log: RunLog, out: Path) -> list[PairLine]:
    _, rows = log.query(
        "SELECT r.pair, r.folder, r.status, r.reason, r.score, r.seconds, (SELECT group_concat(rule, ' ') FROM "
        "(SELECT DISTINCT rule FROM firings f WHERE f.result = r.result ORDER BY rule)) FROM results r "
        "WHERE r.latest = 1"
    )
    found = []
    for name, folder, status, reason, score, seconds, rules in rows:
        home = f"pairs/{quote(str(folder))}"
        files = out / "pairs" / str(folder)
        report = f"{home}/report.html" if folder and (files / "report.html").is_file() else ""
        picture = f"{home}/disparity_view.png" if folder and (files / "disparity_view.png").is_file() else ""
        found.append(
            PairLine(
                str(name),
                str(status),
                str(reason),
                None if score is None else float(str(score)),
                float(str(seconds)),
                str(rules or ""),
                report,
                picture,
            )
        )
    return sorted(found, key=lambda line: natural(line.name))


def _facts(log: RunLog) -> dict[str, list[tuple[str, float]]]:
    _, rows = log.query("SELECT f.fact, r.pair, f.value FROM facts f JOIN results r USING (result) WHERE r.latest = 1")
    found: dict[str, list[tuple[str, float]]] = {}
    for fact, pair, value in sorted(rows, key=lambda row: natural(str(row[1]))):
        found.setdefault(str(fact), []).append((str(pair), float(str(value))))
    return found


def _spread(values: Sequence[float]) -> tuple[float, float]:
    """Return median and robust standard deviation."""
    median = float(np.median(values))
    return median, 1.4826 * float(np.median(np.abs(np.asarray(values) - median)))


def drifts(facts: dict[str, list[tuple[str, float]]]) -> list[Drift]:
    """Return the watched facts over the batch, and after them those that changed most."""
    found = {name: _drift(name, items) for name, items in facts.items() if len(items) >= FEWEST_PAIRS}
    watched = [found[name] for name in WATCHED if name in found]
    others = [item for name, item in found.items() if name not in WATCHED and abs(item.slope) >= TREND]
    return (watched + sorted(others, key=lambda item: -abs(item.slope)))[:MOST_DRIFTS]


def _drift(name: str, items: Sequence[tuple[str, float]]) -> Drift:
    values = [value for _, value in items]
    median, spread = _spread(values)
    low, high = min(values), max(values)
    scale = (HEIGHT - 8) / max(high - low, 1e-12)
    step = (WIDTH - 8) / (len(values) - 1)
    places = [(4 + i * step, HEIGHT - 4 - (value - low) * scale) for i, value in enumerate(values)]
    marks = tuple(
        Mark(x, y, f"{pair}: {value:.4g}")
        for (x, y), (pair, value) in zip(places, items, strict=True)
        if spread > 0 and abs(value - median) > OUTLIER * spread
    )
    slope = float(np.polyfit(np.linspace(0, 1, len(values)), values, 1)[0]) / spread if spread > 0 else 0.0
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    return Drift(name, low, median, high, points, HEIGHT - 4 - (median - low) * scale, marks, slope)


def outliers(facts: dict[str, list[tuple[str, float]]]) -> list[Outlier]:
    """Return the facts that lie far from the rest of the batch, the farthest first."""
    found = []
    for name, items in facts.items():
        if len(items) < FEWEST_PAIRS:
            continue
        median, spread = _spread([value for _, value in items])
        if spread <= 0:
            continue
        found += [
            Outlier(pair, name, value, median, (value - median) / spread)
            for pair, value in items
            if abs(value - median) > OUTLIER * spread
        ]
    return sorted(found, key=lambda item: -abs(item.deviations))[:MOST_OUTLIERS]


def write_page(out: Path) -> Path:
    """Write `index.html` of a batch from its log; return its path."""
    log = RunLog(out / NAME, read_only=True)
    facts, pairs = _facts(log), _pairs(log, out)
    _, counts = log.query("SELECT status, count(*) FROM results WHERE latest = 1 GROUP BY status ORDER BY 2 DESC")
    page = render(
        "expert.batch",
        "batch.html.j2",
        pairs=pairs,
        good=("reconstructed", "disparity_only"),
        reports={pair.name: pair.report for pair in pairs if pair.report},
        seconds=_spread([pair.seconds for pair in pairs])[0] if pairs else 0.0,
        rules=_rules(log, out, len(pairs)),
        counts=counts,
        drift=drifts(facts),
        outlying=outliers(facts),
        size=(WIDTH, HEIGHT),
    )
    write_text(out / PAGE, page)
    return out / PAGE


def _rules(log: RunLog, out: Path, pairs: int) -> list[RuleCount]:
    _, rows = log.query(
        "SELECT f.rule, count(DISTINCT f.result), min(r.folder) FROM firings f JOIN results r USING (result) "
        "WHERE r.latest = 1 GROUP BY f.rule ORDER BY 2 DESC, 1"
    )
    names: dict[str, str] = {}
    for rule, _, folder in rows:
        if str(rule) not in names:
            names.update(_names(out / "pairs" / str(folder) / "decision.json"))
    return [
        RuleCount(str(rule), names.get(str(rule), ""), int(str(count)), 100.0 * int(str(count)) / max(pairs, 1))
        for rule, count, _ in rows
    ]


def _names(path: Path) -> dict[str, str]:
    """Return the names of the rules that fired in a record; none where it cannot be read."""
    try:
        firings = json.loads(path.read_text(encoding="utf-8"))["firings"]
        return {str(firing["rule"]): str(firing["name"]) for firing in firings}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
