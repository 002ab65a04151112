"""A decision record as text, and the words that all renderings share."""

from __future__ import annotations

from collections.abc import Iterator

from expert.decision import Decision, FactRecord, FiringRecord
from expert.plan import Step
from modules.catalog import operators, probes

_VERDICTS = {
    "decided": "A plan was made; nothing was matched yet.",
    "reconstructed": "The pair was reconstructed to terrain.",
    "disparity_only": "The disparity was computed. For 3D points, give a calibration (--calibration FILE).",
    "failed": "The pair could not be reconstructed.",
}


def number_text(value: object) -> str:
    """Write a value for people: four significant digits, lists and tuples alike."""
    if isinstance(value, list | tuple):
        return ", ".join(number_text(item) for item in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _units(record: FactRecord) -> dict[str, str]:
    for probe in probes().values():
        for model in probe.templates:
            if model.template == record.template:
                return {
                    name: str(info.json_schema_extra.get("unit", "1"))
                    for name, info in model.model_fields.items()
                    if isinstance(info.json_schema_extra, dict)
                }
    return {}


def fact_text(record: FactRecord) -> str:
    """Write a fact as `template: field value unit, ...`."""
    units = _units(record)
    parts = []
    for name, value in record.fields.items():
        unit = units.get(name, "1")
        parts.append(f"{name} {number_text(value)}" + (f" {unit}" if unit != "1" else ""))
    return f"{record.template}: {', '.join(parts)}"


def parameter_text(step: Step) -> str:
    """Write the parameters that rules have set, with a leading blank."""
    named = [f"{name}={number_text(value)}" for name, value in sorted(step.parameters.items()) if name in step.set_by]
    return f" ({', '.join(named)})" if named else ""


def firings_of(decision: Decision, rule: str) -> list[FiringRecord]:
    """Return the firings of one rule."""
    return [firing for firing in decision.firings if firing.rule == rule]


def why(decision: Decision, step: Step) -> str:
    """Say who chose an operator and why."""
    if step.chosen_by is None:
        return "the default of its slot; no rule chose another"
    firings = firings_of(decision, step.chosen_by)
    if firings:
        return f"{step.chosen_by} {firings[0].name}: {firings[0].because}"
    return f"{step.chosen_by}, asked for after an earlier trial"


def settings(decision: Decision, step: Step) -> Iterator[str]:
    """Say which rules set parameters of an operator that they did not choose, and why."""
    for parameter, rule in step.set_by.items():
        if rule not in (step.chosen_by, "default"):
            firings = firings_of(decision, rule)
            reason = f"{rule} {firings[0].name}: {firings[0].because}" if firings else f"{rule}, after an earlier trial"
            yield f"{parameter}={number_text(step.parameters[parameter])} by {reason}"


def verdict(decision: Decision) -> str:
    """Say what came out, what was wrong with the pair, what was done and what to trust."""
    wrong = [finding.sentence for finding in decision.findings if finding.severity != "minor"]
    corrected = [step.operator for step in decision.steps() if step.operator.startswith("correction.")]
    sentences = [
        _VERDICTS[decision.status],
        "Found: " + "; ".join(wrong) + "." if wrong else "Nothing unusual was found in the pair.",
    ]
    if decision.status != "failed":
        sentences.append("Corrected by: " + ", ".join(corrected) + "." if corrected else "Nothing was corrected.")
        sentences += _trust(decision)
    return " ".join(sentences)


def _trust(decision: Decision) -> Iterator[str]:
    """Say how much of the products is there and how uncertain it is, from the facts about them."""
    facts = {record.template: record.fields for record in decision.facts}
    density = facts.get("disparity_quality", {}).get("density_fraction")
    if density is not None:
        yield f"Disparity: {100 * float(density):.0f} % of the pixels."
    terrain = facts.get("terrain_quality", {})
    if terrain.get("covered_m2") is not None and terrain.get("median_sigma_m") is not None:
        yield (
            f"Terrain: {float(terrain['covered_m2']):.1f} m2 up to {number_text(terrain.get('extent_m'))} m, "
            f"elevation within {100 * float(terrain['median_sigma_m']):.1f} cm (1 sigma, median)."
        )


def facts_that_mattered(decision: Decision) -> list[FactRecord]:
    """Return the facts that rules fired on, each once."""
    found: list[FactRecord] = []
    for firing in decision.firings:
        for record in firing.bindings.values():
            if record not in found and record.template not in ("finding", "planned", "trial"):
                found.append(record)
    return found


def _steps(decision: Decision) -> Iterator[str]:
    catalog = operators()
    for stage, plan in decision.plans.items():
        for step in plan.steps:
            if step.operator == "none" and not step.losers:
                continue
            summary = catalog[step.operator].summary if step.operator in catalog else "nothing is done in this slot"
            yield f"{stage}.{step.slot}: {step.operator}{parameter_text(step)} - {summary}"
            yield f"    because {why(decision, step)}"
            for reason in settings(decision, step):
                yield f"    with {reason}"
            for loser in step.losers:
                if loser.rule is not None:
                    yield f"    rather than {loser.operator} ({loser.rule}): {loser.lost_because}"


def _trials(decision: Decision) -> Iterator[str]:
    for trial in decision.trials:
        score = "no score" if trial.score is None else f"score {trial.score:.3f}"
        kept = ", kept" if trial.kept else ""
        outcome = trial.failure or trial.answer
        yield f"{trial.stage} trial {trial.number}: {score}{kept}; {outcome}"


def sections(decision: Decision) -> Iterator[tuple[str, list[str]]]:
    """Yield the titles and lines of text and Markdown; a line indented by four belongs to the one before."""
    yield "Findings", [f"{f.severity}: {f.sentence} ({', '.join(f.rules) or f.stage})" for f in decision.findings]
    yield "What was done, and why", list(_steps(decision))
    yield "Facts that mattered", [fact_text(record) for record in facts_that_mattered(decision)]
    fired = {(firing.rule, firing.name, firing.stage) for firing in decision.firings}
    yield "Rules that fired", [f"{rule} {name} ({stage})" for rule, name, stage in sorted(fired)]
    yield "Trials", list(_trials(decision))
    yield "Notes", list(decision.notes)


def as_text(decision: Decision) -> str:
    """Return the explanation as plain text."""
    lines = [f"{decision.pair}: {verdict(decision)}"]
    for title, items in sections(decision):
        if items:
            lines += ["", title, *(f"  {item}" for item in items)]
    return "\n".join(lines) + "\n"
