"""What each rule gains or loses: the cases where it fired, with it and without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from expert.evaluate.cases import Case
from expert.evaluate.run import Progress, evaluate_each
from expert.evaluate.store import Row, Store
from expert.evaluate.systems import ExpertConfiguration
from expert.evaluate.table import BOOTSTRAP_ROUNDS, INTERVAL, resample
from expert.rules.problem import RuleFileError


@dataclass(frozen=True)
class RuleEffect:
    """The worth of one rule.

    Attributes
    ----------
    rule : str
    fired : int
        Cases in which it fired, of those evaluated.
    gain : float or None
        Mean bad-1 without the rule minus with it over those cases, percentage points: positive is good. None where it
        never fired or cannot be left out.
    interval : (float, float) or None
        95 % interval of the gain by a bootstrap over scenes.
    density, wrong, cpu_s : float or None
        Means with the rule minus without it.
    note : str
    """

    rule: str
    fired: int
    gain: float | None = None
    interval: tuple[float, float] | None = None
    density: float | None = None
    wrong: float | None = None
    cpu_s: float | None = None
    note: str = ""


def ablate(
    system: ExpertConfiguration,
    rules: Sequence[str],
    cases: Sequence[Case],
    store: Store,
    *,
    jobs: int = 1,
    progress: Progress = lambda done, total: None,
) -> tuple[RuleEffect, ...]:
    """Leave each rule out, one at a time, on the cases where it fired; elsewhere it cannot matter.

    Parameters
    ----------
    system : ExpertConfiguration
        Already evaluated on the cases.
    rules : sequence of str
    cases, store, jobs, progress
        As for `evaluate`; what was run before is not run again.
    """
    by_key = {case.key: case for case in cases}
    whole = {row.case: row for row in store.rows({system.name: system.digest()}) if row.case in by_key}
    tried = {
        rule: replace(system, name=f"{system.name} without {rule}", disabled=(*system.disabled, rule)) for rule in rules
    }
    fired = {
        rule: [case for key, case in by_key.items() if key in whole and rule in whole[key].rules] for rule in rules
    }
    notes: dict[str, str] = {rule: "never fired" for rule in rules if not fired[rule]}
    wanted = []
    for rule in (rule for rule in rules if fired[rule]):
        try:
            tried[rule].digest()
        except RuleFileError as error:  # other rules hang on it
            notes[rule] = "; ".join(problem.message for problem in error.problems[:1])
        else:
            wanted.append((tried[rule], fired[rule]))
    evaluate_each(wanted, store, jobs=jobs, progress=progress)
    found: dict[str, dict[str, Row]] = {}
    for row in store.rows({one.name: one.digest() for one, _ in wanted}):
        found.setdefault(row.system, {})[row.case] = row
    effects = []
    for rule in rules:
        rest = found.get(tried[rule].name, {})
        both = [(whole[case.key], rest[case.key]) for case in fired[rule] if case.key in rest]
        if both:
            effects.append(_effect(rule, both))
        else:
            effects.append(RuleEffect(rule, len(fired[rule]), note=notes.get(rule, "no case could be run without it")))
    return tuple(effects)


def _effect(rule: str, both: Sequence[tuple[Row, Row]]) -> RuleEffect:
    gain = np.array([without.bad_1 - own.bad_1 for own, without in both])
    scenes = np.array([own.scene for own, _ in both])
    draws = [float(gain[index].mean()) for index in resample(scenes, BOOTSTRAP_ROUNDS, 0)]
    low, high = np.percentile(draws, INTERVAL)
    return RuleEffect(
        rule,
        len(both),
        float(gain.mean()),
        (float(low), float(high)),
        float(np.mean([own.density - without.density for own, without in both])),
        float(np.mean([(own.wrong or 0.0) - (without.wrong or 0.0) for own, without in both])),
        float(np.mean([own.cpu_s - without.cpu_s for own, without in both])),
    )


def effects_text(effects: Sequence[RuleEffect]) -> str:
    """Write the effects for a terminal, the most harmful first."""
    lines = ["gain in bad-1 of each rule on the cases where it fired, percentage points; negative: better without it"]
    for item in sorted(effects, key=lambda effect: (effect.gain is None, effect.gain or 0.0)):
        if item.gain is None or item.interval is None:
            lines.append(f"{item.rule}  {item.note}")
            continue
        lines.append(
            f"{item.rule}  {item.gain:+7.2f} [{item.interval[0]:+.2f}, {item.interval[1]:+.2f}] on {item.fired} cases, "
            f"density {item.density:+.2f}, wrong {item.wrong:+.2f}, CPU {item.cpu_s:+.3f} s {item.note}".rstrip()
        )
    return "\n".join(lines) + "\n"
