"""What was wrong with a pair, what was done and what to trust: three sentences, from the record alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from expert.decision import Decision, FindingRecord
from expert.facts import Scalar
from expert.plan import Step
from expert.report.words import number_text
from modules.catalog import operators

Grade = Literal["good", "care", "bad"]
ABOUT_PAIR = ("measurement", "correction")  # findings of later stages are about the products
LEAST_MASKED = 0.005  # share of the pixels from which on masks are told
MOST = 4  # things that a sentence names
_DONE = {
    "decided": "A plan was made and nothing was run yet",
    "reconstructed": "The pair was reconstructed to terrain",
    "disparity_only": "The disparity was computed, but no terrain",
    "failed": "The pair could not be reconstructed",
}


@dataclass(frozen=True)
class Verdict:
    """Three sentences, and the worst that was found: `bad` also where nothing could be reconstructed."""

    wrong: str
    done: str
    trust: str
    grade: Grade

    @property
    def text(self) -> str:
        """All three."""
        return f"{self.wrong} {self.done} {self.trust}"


def verdict(decision: Decision) -> Verdict:
    """Say what was wrong with the pair, what was done, and what to trust."""
    return Verdict(_wrong(decision), _done(decision), _trust(decision), _grade(decision))


def _grade(decision: Decision) -> Grade:
    found = {finding.severity for finding in decision.findings}
    if decision.status == "failed" or "critical" in found:
        return "bad"
    return "care" if "major" in found else "good"


def _joined(parts: Sequence[str]) -> str:
    """Join by commas and `and`.

    Examples
    --------
    >>> _joined(["a", "b", "c"])
    'a, b and c'
    """
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def _clause(finding: FindingRecord) -> str:
    """Write a finding as a clause among others: what follows a semicolon goes into brackets."""
    said, _, more = finding.sentence.rstrip(".").partition("; ")
    return f"{said} ({more})" if more else said


def _findings(decision: Decision, of_pair: bool, severities: Iterable[str]) -> list[str]:
    wanted = tuple(severities)
    return [
        _clause(finding)
        for finding in decision.findings
        if (finding.stage in ABOUT_PAIR) == of_pair and finding.severity in wanted
    ]


def _wrong(decision: Decision) -> str:
    grave, minor = (_findings(decision, True, kinds) for kinds in (("critical", "major"), ("minor",)))
    if grave:
        more = [f"{len(grave) - MOST + 1} more things"] if len(grave) > MOST else []
        return f"Wrong with the pair: {_joined(grave[: MOST - 1] + more if more else grave)}."
    if minor:
        return f"Nothing grave was wrong with the pair, only this was noted: {_joined(minor)}."
    return "Nothing was found wrong with the pair."


def _told(step: Step) -> str:
    """Name an operator with what it does."""
    catalog = operators()
    name = step.operator.partition(".")[2] or step.operator
    summary = catalog[step.operator].summary.rstrip(".") if step.operator in catalog else ""
    return f"{name} ({summary[0].lower()}{summary[1:]})" if summary else name


def _done(decision: Decision) -> str:
    if decision.status == "failed":
        reasons = _findings(decision, True, ("critical",)) + _findings(decision, False, ("critical",))
        reasons = reasons or [trial.failure for trial in decision.trials if trial.failure]
        return f"{_DONE['failed']}: {_joined(reasons)}." if reasons else f"{_DONE['failed']}."
    parts = [part for part in (_corrected(decision), _matched(decision), _tried(decision)) if part]
    return f"{_DONE[decision.status]}: {'; '.join(parts)}." if parts else f"{_DONE[decision.status]}."


def _corrected(decision: Decision) -> str:
    steps = [step for step in decision.steps() if step.operator.startswith("correction.")]
    return "corrected by " + _joined([_told(step) for step in steps]) if steps else "nothing was corrected"


def _matched(decision: Decision) -> str:
    plan = decision.plans.get("matching")
    matcher = next((step for step in plan.steps if step.slot == "matcher"), None) if plan else None
    if plan is None or matcher is None or matcher.operator == "none":
        return ""
    text = f"matched by {_told(matcher)}"
    ends = next((step.parameters for step in plan.steps if step.slot == "range"), {})
    if "min_px" in ends and "max_px" in ends:
        text += f" from {number_text(ends['min_px'])} to {number_text(ends['max_px'])} px"
    return text


def _tried(decision: Decision) -> str:
    """Say which of several trials was kept, stage by stage."""
    told = []
    for stage in decision.plans:
        trials = [trial for trial in decision.trials if trial.stage == stage]
        kept = next((trial.number for trial in trials if trial.kept), None)
        if len(trials) > 1 and kept is not None:
            told.append(f"of {len(trials)} trials of {stage}, number {kept} was kept")
    return ", ".join(told)


def _trust(decision: Decision) -> str:
    if decision.status == "decided":
        return "There is nothing to trust yet."
    if decision.status == "failed":
        return "Trust none of its products."
    parts = list(_measured({record.template: record.fields for record in decision.facts}))
    doubts = _findings(decision, False, ("critical", "major", "minor"))
    grave = _findings(decision, False, ("critical", "major"))
    start = "Trust only with care" if grave else "Trust"
    trusted = f"{start} {_joined(parts)}" if parts else "Nothing was measured of the products"
    return f"{trusted}; but {_joined(doubts)}." if doubts else f"{trusted}."


def _percent(share: float) -> str:
    """Write a share as whole percent; what is not everything is not told as everything.

    Examples
    --------
    >>> _percent(0.984), _percent(0.998), _percent(1.0)
    ('98 %', 'over 99 %', '100 %')
    """
    return "over 99 %" if 0.995 <= share < 1.0 else f"{100 * share:.0f} %"


def _measured(facts: dict[str, dict[str, Scalar]]) -> Iterator[str]:
    """Say how much of the products is there and how uncertain it is."""
    quality, terrain = facts.get("disparity_quality", {}), facts.get("terrain_quality", {})
    density, right = quality.get("density_fraction"), quality.get("confidence_mean")
    if density is not None:
        masked = 1.0 - float(quality.get("usable_fraction", 1.0))
        notes = [] if right is None else [f"{_percent(float(right))} of these are likely right within 1 px"]
        notes += [f"masks exclude {_percent(masked)}"] if masked >= LEAST_MASKED else []
        text = f"the disparity of {_percent(float(density) * (1.0 - masked))} of the pixels"
        yield f"{text} ({'; '.join(notes)})" if notes else text
    area, sigma = terrain.get("covered_m2"), terrain.get("median_sigma_m")
    if area is not None and sigma is not None:
        yield f"the heights of {float(area):.1f} m2 of ground to {100 * float(sigma):.1f} cm (1 sigma, median)"
