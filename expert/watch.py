"""Decide about one pair again whenever a rule file is saved; the pair is measured once, then only inference runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from expert.api import ExpertSystem
from expert.decision import Decision
from expert.explain import ExplainError
from expert.facts import vocabulary
from expert.firing import RunawayRuleBase
from expert.pair import StereoPair
from expert.plan import PlanError
from expert.redecide import finding_changes, plan_changes
from expert.rules.diff import rule_differences
from expert.rules.model import RuleBase
from expert.rules.problem import RuleFileError
from expert.supervise import Measured
from modules.catalog import probes

Stamp = tuple[tuple[int, int] | None, ...]


def stamp(files: Sequence[Path]) -> Stamp:
    """Return what changes when one of the files is saved: time and size of each, None for one that is not there."""
    found: list[tuple[int, int] | None] = []
    for file in files:
        try:
            status = file.stat()
            found.append((status.st_mtime_ns, status.st_size))
        except OSError:  # an editor may replace a file by removing it first
            found.append(None)
    return tuple(found)


def decision_changes(before: Decision, after: Decision) -> Iterator[str]:
    """Say what differs between two decisions about one pair: rules that fire, plans, findings."""
    old, new = set(before.rules_fired), set(after.rules_fired)
    if new - old:
        yield f"rules that fire now: {', '.join(sorted(new - old))}"
    if old - new:
        yield f"rules that fire no longer: {', '.join(sorted(old - new))}"
    yield from plan_changes(before.plans, after.plans)
    known = [frozenset((item.name, item.severity) for item in decision.findings) for decision in (before, after)]
    yield from finding_changes(*known)
    if before.status != after.status:
        yield f"status: {before.status} -> {after.status}"


class Watch:
    """The last sound decision about one pair, and what was measured of it.

    Parameters
    ----------
    pair : StereoPair
    make : callable
        Makes the system, reading the rule files anew; raises `RuleFileError` where they are wrong.
    progress : callable, optional
        Called with the name of what begins.
    """

    def __init__(
        self, pair: StereoPair, make: Callable[[], ExpertSystem], progress: Callable[[str], None] | None = None
    ) -> None:
        self._pair, self._make, self._progress = pair, make, progress
        self._measured: Measured = {}
        self._rules: RuleBase | None = None
        self.decision: Decision | None = None

    def look(self) -> tuple[str, ...]:
        """Decide again and tell what changed since the last sound decision, rules first, one sentence each.

        Wrong rule files and plans that cannot be made are told, too; the last sound decision stays.
        """
        before, known = self.decision, set(self._measured)
        try:
            system = self._make()
            after = system.decide(self._pair, progress=self._progress, measured=self._measured)
        except RuleFileError as error:
            return tuple(str(problem) for problem in error.problems)
        except (PlanError, RunawayRuleBase) as error:
            return (f"no plan: {error}",)
        old, self._rules, self.decision = self._rules, system.rule_base, after
        if before is None or old is None:
            return ()
        words = vocabulary(probes().values())
        lines = [str(item) for item in rule_differences(old, system.rule_base, words)] or ["the rules are the same"]
        lines += [f"measured for the first time: {name}" for name in sorted(set(self._measured) - known)]
        changes = [*decision_changes(before, after)]
        changes += _why_quiet(system, after, sorted(set(before.rules_fired) - set(after.rules_fired)))
        return (*lines, *(changes or ["the decision about this pair stays"]))


def _why_quiet(system: ExpertSystem, decision: Decision, rules: Sequence[str]) -> Iterator[str]:
    """Tell why rules that fired before do not any more, where they still exist."""
    for rule in rules:
        if rule in system.rule_ids:
            try:
                yield decision.why_not(rule).text().strip()
            except ExplainError as error:
                yield str(error)
