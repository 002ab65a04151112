"""Explanations of a decision that came about in several trials, by the API and by the command."""

from __future__ import annotations

import json
import sys

import pytest
from synthetic_pairs import shifted_pair

from expert import ExpertSystem
from expert.cli import main
from expert.decision import Decision, record_schema
from expert.explain.replan import Replan

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
    system = ExpertSystem(rules=[path], profile="balanced", engine="compiled")
    return system, Decision.from_json(system.reconstruct(shifted_pair()).decision.to_json()), path


def test_the_replay_of_a_repaired_decision_gives_its_plan_and_findings(repaired):
    system, decision, _ = repaired
    assert len([trial for trial in decision.trials if trial.stage == "matching"]) == 2
    outcome = Replan(decision, system._knowledge.rules, system._knowledge.engine).run()
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
    outcome = Replan(keep_second(decision), system._knowledge.rules, system._knowledge.engine).run()
    assert outcome.plans["matching"].operator_of("matcher") == "matching.block_match"


def test_the_replay_follows_a_trial_of_the_matching_back_to_the_correction(tmp_path):
    path = tmp_path / "back.yaml"
    path.write_text(SPARSE.replace("matching.block_match", "correction.normalise_local_contrast"))
    system = ExpertSystem(rules=[path], profile="balanced", engine="compiled")
    decision = keep_second(system.reconstruct(shifted_pair()).decision)
    outcome = Replan(decision, system._knowledge.rules, system._knowledge.engine).run(until="correction")
    assert outcome.plans["correction"].operator_of("local") == "correction.normalise_local_contrast"
    assert decision.what_would_it_take("correction.normalise_local_contrast").already


def test_the_replay_follows_a_trial_of_the_reconstruction_back_to_the_matching(tmp_path):
    path = tmp_path / "back.yaml"
    path.write_text(SPARSE.replace("MAT951", "REC951").replace("stage: matching", "stage: reconstruction"))
    system = ExpertSystem(rules=[path], profile="balanced", engine="compiled")
    decision = system.reconstruct(shifted_pair()).decision
    assert decision.operator("matching.matcher") == "matching.block_match"
    outcome = Replan(decision, system._knowledge.rules, system._knowledge.engine).run()
    assert {stage: plan.configuration() for stage, plan in outcome.plans.items()} == {
        stage: plan.configuration() for stage, plan in decision.plans.items()
    }
    assert outcome.fired == set(decision.rules_fired)
    assert decision.what_would_it_take("matching.block_match").already


def test_why_not_of_a_stage_whose_every_trial_failed_says_so(decision_without_matching):
    answer = decision_without_matching.why_not("matching.block_match")
    assert answer.outcome == "not_reached"
    assert "was tried" in answer.sentence
    assert "never reached" not in answer.sentence


@pytest.fixture
def decision_without_matching(repaired):
    """Return the record as it would be had every matcher failed."""
    _, decision, _ = repaired
    trials = tuple(
        trial.model_copy(update={"kept": False, "failure": "matching.sgm_robust: it is broken"})
        for trial in decision.trials
        if trial.stage == "matching"
    )
    plans = {stage: plan for stage, plan in decision.plans.items() if stage in ("measurement", "correction")}
    return decision.model_copy(update={"trials": trials, "plans": plans})


def test_how_tells_the_trials_and_which_asked_for_a_repair(repaired):
    _, decision, _ = repaired
    text = decision.how("matching").text()
    assert "trial 1: score" in text
    assert "MAT951" in text


def test_why_not_of_an_operator_that_was_tried_or_asked_for_gives_the_reason(repaired):
    _, decision, _ = repaired
    chosen = decision.operator("matching.matcher")
    other = next(
        name for trial in decision.trials if (name := trial.plan.operator_of("matcher")) not in (chosen, "none")
    )
    answer = decision.why_not(other)
    assert answer.outcome in ("lost", "tried")


def test_a_decision_that_was_read_back_answers_every_question(repaired):
    _, decision, _ = repaired
    answer = decision.what_if({"task.profile": "best"})
    assert answer.text().startswith("If task.profile: balanced -> best:")
    assert decision.what_would_it_take(decision.operator("matching.matcher")).already


@pytest.fixture
def ask(repaired, tmp_path, monkeypatch, capsys):
    """Run `terrex explain` on the record and return the exit code and what it says."""
    _, decision, _ = repaired
    record = tmp_path / "decision.json"
    record.write_text(decision.to_json())

    def run(*arguments, file=record):
        monkeypatch.setattr(sys, "argv", ["terrex", "explain", *([str(file)] if file else []), *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out + said.err

    return run


def test_the_command_answers_all_questions_at_once_without_the_rule_files(ask, repaired):
    _, _, rules = repaired
    kept = rules.read_text()
    rules.write_text("version: 1\nrules: [gone]\n")
    what = ["--how", "matcher", "--why-not", "MAT951", "--what-if", "task.profile=best", "--margins"]
    code, said = ask(*what, "--take", "matching.block_match")
    rules.write_text(kept)
    assert code == 0, said
    assert "matching.matcher: " in said
    assert f"MAT951 never-good-enough ({rules}:3)" in said
    assert "If task.profile: balanced -> best" in said
    assert "How near each measured value was" in said


def test_the_command_tells_everything_when_nothing_is_asked(ask):
    code, said = ask()
    assert code == 0
    assert "correction.radiometry: " in said
    assert "reconstruction.grid: " in said


def test_the_command_answers_as_data(ask, repaired):
    code, said = ask("--margins", "--why-not", "MAT951", "--json")
    why_not, margins = json.loads(said)
    assert (code, why_not["name"]) == (0, "MAT951")
    assert margins == repaired[1].margins().model_dump(mode="json")


def test_the_command_prints_provenance_and_the_schema(ask, repaired):
    _, decision, _ = repaired
    assert json.loads(ask("--prov")[1])["entity"][f"terrex:decision/{decision.id}"]["terrex:status"] == decision.status
    assert json.loads(ask("--schema", file=None)[1]) == record_schema()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--what-if", "task.profile"), "is not FACT.FIELD=VALUE"),
        (("--how", "matchr"), "did you mean"),
        (("--take", "matching.blok_match"), "did you mean 'matching.block_match'"),
    ],
)
def test_the_command_leaves_with_2_and_a_sentence_on_a_wrong_question(ask, arguments, message):
    code, said = ask(*arguments)
    assert code == 2
    assert message in said


def test_the_command_leaves_with_2_when_there_is_no_record(ask, tmp_path):
    code, said = ask(file=tmp_path / "none.json")
    assert code == 2
    assert "none.json: cannot read the file: No such file or directory" in said
    assert ask(file=None) == (2, "give the decision.json to explain\n")
