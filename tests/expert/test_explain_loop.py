"""Explanations of a decision that came about in several trials, by the API and by the command."""

from __future__ import annotations

import pytest
import typer
from synthetic_pairs import shifted_pair
from typer.testing import CliRunner

from expert import ExpertSystem
from expert.cli.explain import explain as explain_command
from expert.decision import Decision
from expert.explain.replay import Replay

SPARSE = """version: 1
rules:
  - id: MAT951
    name: never-good-enough
    stage: matching
    when:
      - {fact: disparity_quality, field: density_fraction, op: ge, value: 0.0}
      - {fact: trial, field: number, op: eq, value: 1}
    then: [{repair: matching.block_match, score: 1.0}]
    because: A second trial is wanted for the test.
    references: [none]
"""


@pytest.fixture(scope="module")
def repaired(tmp_path_factory):
    """Return a system and the record of a pair that it matched twice."""
    path = tmp_path_factory.mktemp("layer") / "sparse.yaml"
    path.write_text(SPARSE)
    system = ExpertSystem(rules=[path], profile="fast", engine="compiled")
    return system, Decision.from_json(system.reconstruct(shifted_pair()).decision.to_json()), path


def test_the_replay_of_a_repaired_decision_gives_its_plan_and_findings(repaired):
    system, decision, _ = repaired
    assert len([trial for trial in decision.trials if trial.stage == "matching"]) == 2
    outcome = Replay(decision, system._knowledge.rules, system._knowledge.engine).run()
    assert {stage: plan.configuration() for stage, plan in outcome.plans.items()} == {
        stage: plan.configuration() for stage, plan in decision.plans.items()
    }
    assert outcome.findings == {(finding.name, finding.severity) for finding in decision.findings if finding.rules}
    assert outcome.fired == set(decision.rules_fired)


def keep_second(decision):
    """Return the record as it would be had the second trial of the matching been the better one."""
    trials = tuple(
        trial.model_copy(update={"kept": trial.number == 2}) if trial.stage == "matching" else trial
        for trial in decision.trials
    )
    return decision.model_copy(update={"trials": trials})


def test_the_replay_follows_a_repair_that_was_kept(repaired):
    system, decision, _ = repaired
    outcome = Replay(keep_second(decision), system._knowledge.rules, system._knowledge.engine).run()
    assert outcome.plans["matching"].operator_of("matcher") == "matching.block_match"


def test_the_replay_follows_a_trial_of_the_matching_back_to_the_correction(tmp_path):
    path = tmp_path / "back.yaml"
    path.write_text(SPARSE.replace("matching.block_match", "correction.normalise_local_contrast"))
    system = ExpertSystem(rules=[path], profile="fast", engine="compiled")
    decision = keep_second(system.reconstruct(shifted_pair()).decision)
    outcome = Replay(decision, system._knowledge.rules, system._knowledge.engine).run(until="correction")
    assert outcome.plans["correction"].operator_of("local") == "correction.normalise_local_contrast"
    assert system.what_would_it_take(decision, "correction.normalise_local_contrast").already


def test_how_tells_the_trials_and_which_asked_for_a_repair(repaired):
    system, decision, _ = repaired
    text = system.how(decision, "matching").text()
    assert "trial 1: score" in text
    assert "MAT951" in text


def test_why_not_of_an_operator_that_was_tried_or_asked_for_gives_the_reason(repaired):
    system, decision, _ = repaired
    chosen = decision.operator("matching.matcher")
    other = next(
        name for trial in decision.trials if (name := trial.plan.operator_of("matcher")) not in (chosen, "none")
    )
    answer = system.why_not(decision, other)
    assert answer.outcome in ("lost", "tried")


def test_the_system_answers_every_question_on_its_decision(repaired):
    system, decision, _ = repaired
    answer = system.what_if(decision, {"task.profile": "best"})
    assert answer.text().startswith("If task.profile: fast -> best:")
    assert system.what_would_it_take(decision, decision.operator("matching.matcher")).already


@pytest.fixture(scope="module")
def app():
    application = typer.Typer()
    application.command()(explain_command)
    return application


@pytest.fixture
def ask(app, repaired, tmp_path):
    _, decision, rules = repaired
    record = tmp_path / "decision.json"
    record.write_text(decision.to_json())

    def run(*arguments, layer=True):
        options = ["--rules", str(rules)] if layer else []
        return CliRunner().invoke(app, [str(record), *options, "--engine", "compiled", *map(str, arguments)])

    return run


def test_the_command_answers_all_questions_at_once(ask):
    what = [
        "--how",
        "matcher",
        "--why-not",
        "MAT951",
        "--what-if",
        "task.profile=best",
        "--take",
        "matching.block_match",
    ]
    result = ask(*what)
    assert result.exit_code == 0, result.output
    assert "matching.matcher: " in result.output
    assert "MAT951" in result.output
    assert "If task.profile: fast -> best" in result.output


def test_the_command_tells_everything_when_nothing_is_asked(ask):
    result = ask()
    assert result.exit_code == 0
    assert "correction.radiometry: " in result.output
    assert "reconstruction.grid: " in result.output


def test_the_command_leaves_with_2_when_the_rules_are_others(ask):
    result = ask("--how", "matcher", layer=False)
    assert result.exit_code == 2
    assert "the decision was made with rules" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--what-if", "task.profile"), "is not FACT.FIELD=VALUE"),
        (("--how", "matchr"), "did you mean"),
        (("--take", "matching.blok_match"), "did you mean 'matching.block_match'"),
    ],
)
def test_the_command_leaves_with_2_and_a_sentence_on_a_wrong_question(ask, arguments, message):
    result = ask(*arguments)
    assert result.exit_code == 2
    assert message in result.output


def test_the_command_leaves_with_2_when_there_is_no_record(app, tmp_path):
    result = CliRunner().invoke(app, [str(tmp_path / "none.json")])
    assert result.exit_code == 2
    assert "cannot read the file" in result.output
