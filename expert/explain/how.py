"""How a choice came about."""

from __future__ import annotations

import itertools

from expert.decision import ConditionRecord, Decision, FiringRecord
from expert.explain.model import How, Node, number
from expert.explain.record import check_digest, findings_in, source_of, unknown
from expert.facts import Vocabulary, vocabulary
from expert.plan import Candidate, Step
from expert.rules.explain import condition_text
from expert.rules.load import KnownRules
from expert.rules.model import AnyOf, Comparison, Condition, Exists, FindingCondition, Not
from expert.rules.strata import conditions_of
from modules.catalog import probes

INTERNAL = frozenset({"finding", "planned", "trial", "failure"})


class _Teller:
    """Builds the tree for one decision."""

    def __init__(self, decision: Decision, rules: KnownRules | None) -> None:
        self.decision = decision
        self.rules = rules
        self.words: Vocabulary = vocabulary(probes().values())

    def slot(self, stage: str, step: Step) -> Node:
        children: list[Node] = []
        if step.chosen_by is None:
            all_lost = any(loser.rule is not None for loser in step.losers)
            reason = "every other candidate was excluded" if all_lost else "no rule chose another"
            children.append(Node(sentence=f"it is the default of the slot; {reason}"))
        else:
            children += self.rule(step.chosen_by)
        for name, value in sorted(step.parameters.items()):
            rule = step.set_by.get(name)
            if rule is not None and rule not in ("default", step.chosen_by):
                children.append(Node(sentence=f"{name} = {value}, set by {rule}", children=self.rule(rule)))
            elif rule is not None:
                children.append(Node(sentence=f"{name} = {value}, set by {rule}"))
        children += [self.loser(loser) for loser in step.losers if loser.rule is not None]
        children += [
            Node(sentence=f"rather than {item.parameter} = {number(item.value)} ({item.rule}): {item.lost_because}")
            for item in step.lost_settings
        ]
        what = "nothing is done" if step.operator == "none" else step.operator
        return Node(sentence=f"{stage}.{step.slot}: {what}", children=tuple(children))

    def loser(self, loser: Candidate) -> Node:
        what = "nothing" if loser.operator == "none" else loser.operator
        return Node(sentence=f"rather than {what} ({loser.rule}, score {loser.score:g}): {loser.lost_because}")

    def rule(self, rule: str, above: tuple[str, ...] = ()) -> tuple[Node, ...]:
        """Return the firings of a rule, each once, or where else its wish came from."""
        firings = [firing for firing in self.decision.firings if firing.rule == rule]
        if not firings:
            asked = [
                trial
                for trial in self.decision.trials
                if rule in trial.answer.replace("(", " ").replace(")", " ").split()
            ]
            after = f" after {asked[0].stage} trial {asked[0].number}" if asked else " after an earlier trial"
            return (Node(sentence=f"{rule} asked for it{after}"),)
        return tuple(self.firing(firing, (*above, rule)) for firing in firings)

    def firing(self, firing: FiringRecord, above: tuple[str, ...] = ()) -> Node:
        where = f" ({source_of(self.rules, firing.rule)})" if self.rules else ""
        because = " ".join(firing.because.split()).rstrip(".")
        names = f" [{'; '.join(firing.references)}]" if firing.references else ""
        return Node(
            sentence=f"{firing.rule} {firing.name}{where} fired: {because}{names}",
            children=(*self.conditions(firing), *self.findings(firing, above)),
        )

    def conditions(self, firing: FiringRecord) -> list[Node]:
        """Return what the rule asks for and what was measured; of groups also what is inside."""
        if self.rules is None:
            return [Node(sentence=f"when {item.text}{self.measured(item, firing)}") for item in firing.conditions]
        rule = self.rules.base.by_id[firing.rule]
        thresholds = self.rules.base.thresholds
        recorded = iter(firing.conditions)
        nodes = []
        for condition in rule.when:
            leaves = tuple(itertools.islice(recorded, _leaves(condition)))
            sentence = f"when {condition_text(condition, self.words, thresholds)}"
            if isinstance(condition, Comparison | FindingCondition):
                nodes.append(Node(sentence=sentence + "".join(self.measured(item, firing) for item in leaves)))
            else:
                inside = (
                    Node(sentence=f"{item.text}: {_verdict(item)}{self.measured(item, firing)}")
                    for item in leaves
                    if item.field is not None
                )
                nodes.append(Node(sentence=sentence, children=tuple(inside)))
        return nodes

    def measured(self, item: ConditionRecord, firing: FiringRecord) -> str:
        """Say what a condition found, by how much, and who measured it."""
        if item.fact is None or item.field is None or item.template in INTERNAL:
            return ""
        margin = ""
        if item.margin is not None:
            side = "beyond the limit" if item.margin >= 0 else "short of the limit"
            margin = f", {number(abs(item.margin), item.unit)} {side}" if item.margin else ", exactly at the limit"
        which = f" in {item.fact}" if "[" in item.fact else ""
        return f": {number(item.value, item.unit)}{which}{margin} ({self.source(item, firing)})"

    def source(self, item: ConditionRecord, firing: FiringRecord) -> str:
        records = [*firing.bindings.values(), *self.decision.facts]
        found = (
            record
            for record in records
            if record.template == item.template and record.fields.get(item.field or "") == item.value
        )
        record = next(found, None)
        return f"measured by {record.probe}" if record is not None and record.probe else "stated"

    def findings(self, firing: FiringRecord, above: tuple[str, ...]) -> list[Node]:
        """Return the findings that the rule asks for and that were there, with the rules that derived them."""
        names = {str(record.fields.get("name")) for record in firing.bindings.values() if record.template == "finding"}
        if self.rules is not None:
            names |= {item.finding for item in findings_in(self.rules.base.by_id[firing.rule].when)}
        nodes = []
        for finding in self.decision.findings:
            if finding.name in names:
                sources = [name for name in finding.rules if name not in above]
                below = tuple(node for name in sources for node in self.rule(name, above))
                sentence = f"{finding.severity} finding {finding.name}: {finding.sentence}"
                nodes.append(Node(sentence=sentence, children=below))
        return nodes

    def trials(self, stage: str) -> list[Node]:
        """Return what became of the trials of a stage."""
        nodes = []
        for trial in self.decision.trials:
            if trial.stage == stage:
                score = "no score" if trial.score is None else f"score {trial.score:.3f}"
                kept = ", kept" if trial.kept else ""
                nodes.append(Node(sentence=f"trial {trial.number}: {score}{kept}; {trial.failure or trial.answer}"))
        return nodes


def _leaves(condition: Condition) -> int:
    """Return how many comparisons and findings are in a condition."""
    if isinstance(condition, Comparison | FindingCondition):
        return 1
    if isinstance(condition, Not):
        return sum(map(_leaves, conditions_of(condition.not_)))
    if isinstance(condition, Exists):
        return sum(map(_leaves, conditions_of(condition.exists)))
    if isinstance(condition, AnyOf):
        return sum(_leaves(item) for branch in condition.any_of for item in conditions_of(branch))
    return sum(map(_leaves, (*condition.for_all.where, *condition.for_all.then)))


def _verdict(item: ConditionRecord) -> str:
    return "holds" if item.holds else "does not hold"


def how(decision: Decision, subject: str, rules: KnownRules | None = None) -> How:
    """Return the tree of firings and facts behind a choice.

    Parameters
    ----------
    decision : Decision
    subject : str
        A stage (`matching`), a slot (`matching.matcher` or `matcher`), an operator of the plan, or a finding.
    rules : KnownRules, optional
        The rules of the decision; with them every condition and every finding behind it is told.

    Raises
    ------
    ExplainError
        The decision has no such stage, slot, operator or finding, or was made with other rules.
    """
    if rules is not None:
        check_digest(decision, rules)
    teller = _Teller(decision, rules)
    if subject == "measurement":
        firings = [firing for firing in decision.firings if firing.stage == "measurement"]
        return How(subject=subject, nodes=tuple(teller.firing(firing) for firing in firings))
    steps = [(stage, step) for stage, plan in decision.plans.items() for step in plan.steps]
    wanted = [
        teller.slot(stage, step)
        for stage, step in steps
        if subject in (stage, f"{stage}.{step.slot}", step.slot) or (subject == step.operator and subject != "none")
    ]
    wanted += teller.trials(subject)
    wanted += [
        Node(
            sentence=f"{finding.severity} finding {finding.name}: {finding.sentence}",
            children=tuple(node for rule in finding.rules for node in teller.rule(rule)),
        )
        for finding in decision.findings
        if finding.name == subject
    ]
    if not wanted:
        known = [*decision.plans, *(f"{stage}.{step.slot}" for stage, step in steps)]
        known += [step.operator for _, step in steps] + [finding.name for finding in decision.findings]
        raise unknown("stage, slot, operator of the plan or finding", subject, known)
    return How(subject=subject, nodes=tuple(wanted))
