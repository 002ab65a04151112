"""Why an operator was not chosen, or why a rule did not fire."""

from __future__ import annotations

from collections.abc import Sequence

from expert.decision import Decision
from expert.explain.model import RuleVerdict, WhyNot
from expert.explain.record import check_digest, facts_of_stage, proposes, source_of, unit_of, unknown
from expert.facts import Vocabulary, vocabulary
from expert.plan import Step
from expert.rules.evaluate import finding_of
from expert.rules.explain import action_text, condition_text
from expert.rules.load import KnownRules
from expert.rules.margin import Judge
from expert.rules.model import Choose, Comparison, Condition, Exclude, FindingCondition, Not, Repair, Rule, Stage
from modules.catalog import operators, probes
from modules.operator import Operator

NO_FACT = "there is no such fact"  # how `Judge` says so


class _Inquiry:
    """Reads the rules of one decision on the facts that they saw."""

    def __init__(self, decision: Decision, rules: KnownRules) -> None:
        self.decision, self.rules = decision, rules
        self.words: Vocabulary = vocabulary(probes().values())
        self.fired = set(decision.rules_fired)
        self._judges: dict[Stage, Judge] = {}
        self._proposing: dict[str, list[tuple[Rule, Choose | Repair]]] = {}
        self._finding: dict[str, list[Rule]] = {}
        for rule in sorted(rules.base.rules, key=lambda rule: rule.id):
            for action in rule.then:
                if isinstance(action, Choose | Repair):
                    self._proposing.setdefault(proposes(action) or "", []).append((rule, action))
        for rule in rules.base.rules:
            for name in {str(fact.get("name")) for fact in map(finding_of, rule.then) if fact is not None}:
                self._finding.setdefault(name, []).append(rule)

    def judge(self, stage: Stage) -> Judge:
        if stage not in self._judges:
            self._judges[stage] = Judge(self.rules.base, self.words, facts_of_stage(self.decision, stage))
        return self._judges[stage]

    def _failing(self, rule: Rule, text: str) -> Condition | None:
        """Return the condition that a text describes."""
        thresholds = self.rules.base.thresholds
        written = [(condition_text(item, self.words, thresholds), item) for item in rule.when]
        return next((item for clause, item in written if text in (clause, f"{clause}: {NO_FACT}")), None)

    def _deriving(self, condition: Condition | None, above: frozenset[str]) -> tuple[RuleVerdict, ...]:
        """Return why no rule derived the finding that a condition asks for."""
        if not isinstance(condition, FindingCondition):
            return ()
        return tuple(
            self.verdict(rule, f"derive the finding {condition.finding}", above=above)
            for rule in self._finding.get(condition.finding, ())
            if rule.id not in above
        )

    def verdict(
        self, rule: Rule, would: str, would_win: bool | None = None, above: frozenset[str] = frozenset()
    ) -> RuleVerdict:
        """Say whether a rule fired, and what kept it from that."""
        seen = RuleVerdict(
            rule=rule.id,
            name=rule.name,
            source=source_of(self.rules, rule.id),
            would=would,
            fired=rule.id in self.fired,
            would_win=would_win,
        )
        if seen.fired:
            return seen
        failing = self.judge(rule.stage).first_failing(rule)
        if failing is None:
            return seen
        condition = self._failing(rule, failing.condition)
        text = failing.condition
        if isinstance(condition, Comparison) and failing.value is None and not text.endswith(NO_FACT):
            text += ", which is not known"
        return seen.model_copy(
            update={
                "condition": text,
                "below": self._deriving(condition, above | {rule.id}),
                "value": failing.value,
                "limit": failing.limit,
                "unit": _unit(condition, self.words),
                "margin": failing.margin,
            }
        )

    def wins(self, action: Choose | Repair, rule: Rule, step: Step) -> bool:
        """Say whether a proposal would beat the one that fills its slot."""
        holder = self.rules.base.by_id.get(step.chosen_by or "")
        if holder is None:
            return True
        scores = [item.score for item in holder.then if isinstance(item, Choose | Repair) and _gives(item, step)]
        rival = (-max(scores, default=0.0), -holder.priority, holder.id)
        return (-action.score, -rule.priority, rule.id) < rival

    def excluding(self, operator: str) -> list[Rule]:
        """Return the rules that fired and exclude an operator."""
        return [
            rule
            for rule in self.rules.base.rules
            if rule.id in self.fired
            and any(isinstance(action, Exclude) and action.exclude == operator for action in rule.then)
        ]

    def would_choose(self, operator: str, step: Step | None) -> list[RuleVerdict]:
        """Return the verdict on every rule that ever proposes an operator, the nearest to firing first."""
        return [
            self.verdict(
                rule, action_text(action, self.rules.base.thresholds), self.wins(action, rule, step) if step else None
            )
            for rule, action in self._proposing.get(operator, ())
        ]


def _unit(condition: Condition | None, words: Vocabulary) -> str:
    inner = condition.not_ if isinstance(condition, Not) else condition
    return unit_of(words, inner.fact, inner.field) if isinstance(inner, Comparison) else "1"


def _gives(action: Choose | Repair, step: Step) -> bool:
    return proposes(action) == step.operator


def why_not(decision: Decision, rules: KnownRules, name: str) -> WhyNot:
    """Say why an operator was not chosen, or why a rule did not fire.

    Parameters
    ----------
    decision : Decision
    rules : KnownRules
        The rules of the decision.
    name : str
        An operator, or the id or name of a rule.

    Raises
    ------
    ExplainError
        There is no such operator or rule, or the decision was made with other rules.
    """
    check_digest(decision, rules)
    inquiry = _Inquiry(decision, rules)
    for rule in rules.base.rules:
        if name in (rule.id, rule.name):
            return _why_not_rule(inquiry, rule)
    if name not in operators():
        raise unknown("operator or rule", name, [*operators(), *rules.base.by_id])
    return _why_not_operator(inquiry, operators()[name])


def not_chosen(decision: Decision, rules: KnownRules) -> tuple[WhyNot, ...]:
    """Say of every operator that fills no slot why not, by name.

    Raises
    ------
    ExplainError
        The decision was made with other rules.
    """
    check_digest(decision, rules)
    inquiry = _Inquiry(decision, rules)
    answers = (_why_not_operator(inquiry, operator) for _, operator in sorted(operators().items()))
    return tuple(answer for answer in answers if answer.outcome != "chosen")


def _why_not_rule(inquiry: _Inquiry, rule: Rule) -> WhyNot:
    would = ", and ".join(action_text(action, inquiry.rules.base.thresholds) for action in rule.then)
    verdict = inquiry.verdict(rule, would)
    if verdict.fired:
        lost = [
            f"{loser.operator} lost {stage}.{step.slot}: {loser.lost_because}"
            for stage, plan in inquiry.decision.plans.items()
            for step in plan.steps
            for loser in step.losers
            if loser.rule == rule.id
        ]
        sentence = f"{rule.id} did fire" + (f", but {'; '.join(lost)}." if lost else ".")
        return WhyNot(name=rule.id, kind="rule", outcome="fired", sentence=sentence, rules=(verdict,))
    if rule.stage != "measurement" and rule.stage not in inquiry.decision.plans:
        return WhyNot(name=rule.id, kind="rule", outcome="not_reached", sentence=_unreached(inquiry, rule.stage))
    sentence = f"{rule.id} did not fire."
    return WhyNot(name=rule.id, kind="rule", outcome="conditions", sentence=sentence, rules=(verdict,))


def _unreached(inquiry: _Inquiry, stage: str) -> str:
    tried = [trial for trial in inquiry.decision.trials if trial.stage == stage]
    if tried:
        failures = "; ".join(trial.failure or "" for trial in tried)
        return f"The stage {stage} was tried and every trial failed, so it has no plan: {failures}."
    critical = [finding for finding in inquiry.decision.findings if finding.severity == "critical"]
    why = "; ".join(f"{finding.sentence} ({', '.join(finding.rules)})" for finding in critical)
    return f"The stage {stage} was never reached" + (f", because {why}." if why else ".")


def _why_not_operator(inquiry: _Inquiry, operator: Operator) -> WhyNot:
    name, decision = operator.name, inquiry.decision
    plan = decision.plans.get(operator.stage)
    if plan is None:
        return WhyNot(name=name, kind="operator", outcome="not_reached", sentence=_unreached(inquiry, operator.stage))
    slot = f"{operator.stage}.{operator.slot}"
    step = next((item for item in plan.steps if item.slot == operator.slot), None)
    if step is None:
        return WhyNot(name=name, kind="operator", outcome="never", sentence=f"The rules declare no slot {slot}.")
    verdicts = inquiry.would_choose(name, step)
    holder = f"{step.operator} ({step.chosen_by or 'the default'})"
    if step.operator == name:
        return WhyNot(
            name=name,
            kind="operator",
            outcome="chosen",
            sentence=f"{name} was chosen for {slot}, by {step.chosen_by or 'default'}.",
            rules=tuple(verdict for verdict in verdicts if verdict.fired),
        )
    for answer in (_failed(inquiry, name), _excluded(inquiry, name), _lost(step, name), _tried(inquiry, operator)):
        if answer is not None:
            sentence = f"{name} does not fill {slot}, which {holder} fills: {answer[1]}."
            return WhyNot(
                name=name, kind="operator", outcome=answer[0], sentence=sentence, rules=tuple(_unfired(verdicts))
            )
    if any(verdict.fired for verdict in verdicts):
        sentence = f"{name} does not fill {slot}, which {holder} fills: " + _without_effect(inquiry, verdicts)
        return WhyNot(name=name, kind="operator", outcome="lost", sentence=sentence, rules=tuple(_unfired(verdicts)))
    if not verdicts:
        sentence = f"No rule ever chooses {name}; {slot} is filled by {holder}."
        return WhyNot(name=name, kind="operator", outcome="never", sentence=sentence)
    sentence = f"{name} does not fill {slot}, which {holder} fills: no rule that proposes it fired."
    return WhyNot(name=name, kind="operator", outcome="conditions", sentence=sentence, rules=tuple(verdicts))


def _without_effect(inquiry: _Inquiry, verdicts: Sequence[RuleVerdict]) -> str:
    """Say why rules that fired gave no candidate: asked too late, or a parameter that could not be computed."""
    parts = []
    rules = inquiry.rules.base.by_id
    for verdict in verdicts:
        if verdict.fired and any(isinstance(action, Repair) for action in rules[verdict.rule].then):
            parts.append(f"{verdict.rule} asked for it after the trial that was kept, and no better trial came of it")
        elif verdict.fired:
            parts.append(f"{verdict.rule} fired, but a fact that its parameters are computed from is not known")
    return "; ".join(parts) + "."


def _unfired(verdicts: Sequence[RuleVerdict]) -> list[RuleVerdict]:
    return [verdict for verdict in verdicts if not verdict.fired]


def _failed(inquiry: _Inquiry, name: str) -> tuple[str, str] | None:
    for trial in inquiry.decision.trials:
        if trial.failure is not None and trial.failure.startswith(f"{name}:"):
            return "failed", f"it failed in {trial.stage} trial {trial.number}: {trial.failure.partition(': ')[2]}"
    return None


def _excluded(inquiry: _Inquiry, name: str) -> tuple[str, str] | None:
    rules = inquiry.excluding(name)
    if not rules:
        return None
    by = "; ".join(f"{rule.id} {rule.name}: {' '.join(rule.because.split()).rstrip('.')}" for rule in rules)
    return "excluded", f"it was excluded by {by}"


def _lost(step: Step, name: str) -> tuple[str, str] | None:
    losers = [loser for loser in step.losers if loser.operator == name]
    if not losers:
        return None
    parts = [
        f"{loser.rule} proposed it with score {loser.score:g}, but {loser.lost_because}"
        if loser.rule
        else f"it is the default of the slot, and {loser.lost_because}"
        for loser in losers
    ]
    return "lost", "; ".join(parts)


def _tried(inquiry: _Inquiry, operator: Operator) -> tuple[str, str] | None:
    trials = [
        trial
        for trial in inquiry.decision.trials
        if trial.stage == operator.stage and trial.plan.operator_of(operator.slot) == operator.name
    ]
    kept = next((trial for trial in inquiry.decision.trials if trial.stage == operator.stage and trial.kept), None)
    if not trials or kept is None:
        return None
    scores = ", ".join(f"trial {trial.number} with score {trial.score or 0.0:.3f}" for trial in trials)
    return "tried", f"it ran in {scores}, but trial {kept.number} was kept with score {kept.score or 0.0:.3f}"
