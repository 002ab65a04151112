from __future__ import annotations

import json

import pytest
from synthetic_pairs import shifted_pair
from typer.testing import CliRunner

from expert import ExpertSystem
from expert.cli.rules import app
from expert.decision import Decision
from expert.engine import ENGINES, make_engine
from expert.explain import rules_of
from expert.facts import Fact, vocabulary
from expert.knowledge import Knowledge
from expert.recorder import inputs_record
from expert.redecide import read_records, redecide, redecided
from expert.rules.load import load_rules
from expert.supervise import Run
from modules.catalog import operators, probes
from modules.types import Calibration

RULES = """version: 1
thresholds: {exposure_dn: {value: 6.0, unit: dn, because: a test}}
findings: {exposure-differs: the images differ in exposure}
slots:
  correction:
    - {slot: radiometry, default: none, because: nothing}
rules:
  - id: MEA901
    name: exposure-differs
    stage: measurement
    when: [{fact: brightness, field: mean_difference_dn, op: abs_ge, value: {threshold: exposure_dn}}]
    then: [{derive: exposure-differs, severity: major}]
    because: The means of the two images differ.
    references: [none]
  - id: COR901
    name: exposure-differs-globally
    stage: correction
    when: [{finding: exposure-differs}]
    then: [{choose: correction.match_histograms, with: {channels: each}, score: 0.8}]
    because: One map removes the difference.
    references: [none]
"""
INPUTS = inputs_record(shifted_pair())
WORDS = vocabulary(probes().values())
ENGINE = make_engine("compiled", WORDS)


def loaded(tmp_path, text, name="rules.yaml"):
    path = tmp_path / name
    path.write_text(text)
    return load_rules([path], WORDS, operators(), probes(), shipped=False)


def decision(rules, difference_dn):
    facts = {
        Fact.of("task", profile="balanced", range_given=False): None,
        Fact.of("brightness", mean_difference_dn=difference_dn): "measurement.brightness",
    }
    run = Run(Knowledge(rules, ENGINE, operators(), {}), None, facts)
    run.decide_measurement()
    run.plan("correction")
    return Decision(
        pair=f"differs by {difference_dn:g}",
        status="decided",
        profile="balanced",
        rules_digest=rules.digest,
        inputs=INPUTS,
        facts=run.fact_records(),
        firings=run.firing_records(),
        findings=run.findings(),
        plans={plan.stage: plan for plan in run.plans.values()},
    )


def test_the_same_rules_decide_the_same(tmp_path):
    rules = loaded(tmp_path, RULES)
    assert redecide("a", decision(rules, 9.0), rules, rules, ENGINE).changes == ()


@pytest.mark.parametrize(("difference_dn", "changes"), [(5.0, 0), (6.0, 2), (7.5, 2), (8.0, 0)])
def test_a_moved_threshold_changes_just_the_pairs_between_its_places(tmp_path, difference_dn, changes):
    old, new = loaded(tmp_path, RULES), loaded(tmp_path, RULES.replace("6.0", "8.0"))
    found = redecide("a", decision(old, difference_dn), old, new, ENGINE).changes
    assert len(found) == changes
    if changes:
        assert found == (
            "correction.radiometry: correction.match_histograms (COR901) -> none (default)",
            "finding gone: exposure-differs (major)",
        )


def test_changed_parameters_and_new_slots_are_changes(tmp_path):
    old = loaded(tmp_path, RULES)
    new = loaded(
        tmp_path,
        RULES.replace("channels: each", "channels: gray").replace(
            "slots:\n  correction:\n",
            "slots:\n  correction:\n    - {slot: denoise, default: correction.denoise_gaussian, because: a test}\n",
        ),
    )
    assert redecide("a", decision(old, 9.0), old, new, ENGINE).changes == (
        "correction.radiometry: correction.match_histograms with channels each -> gray",
        "correction.denoise: none (default) -> correction.denoise_gaussian (default)",
    )


def test_a_plan_that_becomes_impossible_is_a_change(tmp_path):
    old = loaded(tmp_path, RULES)
    formula = "{div: [{field: brightness.mean_difference_dn}, {value: 0.001, unit: dn/px}]}"
    new = loaded(
        tmp_path,
        RULES.replace("[{finding: exposure-differs}]", "[{finding: exposure-differs}, {fact: brightness}]")
        .replace("correction.match_histograms", "correction.denoise_gaussian")
        .replace("channels: each", f"sigma_px: {formula}")
        .replace("slot: radiometry", "slot: denoise"),
    )
    (change,) = redecide("a", decision(old, 9.0), old, new, ENGINE).changes
    assert change.startswith("a plan -> no plan (correction.denoise_gaussian: sigma_px: ")


def test_broken_records_are_named_and_other_files_passed_over(tmp_path):
    rules = loaded(tmp_path, RULES)
    text = decision(rules, 9.0).to_json()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "decision.json").write_text(text)
    (tmp_path / "edited.json").write_text(text.replace("differs by 9", "differs by 1"))
    (tmp_path / "other.json").write_text("[]")
    found, problems = read_records(tmp_path)
    assert [file for file, _ in found] == [str(tmp_path / "sub" / "decision.json")]
    assert len(problems) == 1
    assert problems[0].startswith(f"{tmp_path / 'edited.json'}: the record was changed")


def invoke(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_the_command_tells_the_threshold_and_the_decisions_it_changes(tmp_path):
    old, new, folder = tmp_path / "old.yaml", tmp_path / "new.yaml", tmp_path / "records"
    rules = loaded(tmp_path, RULES, "old.yaml")
    new.write_text(RULES.replace("6.0", "8.0"))
    folder.mkdir()
    for number, difference in enumerate((5.0, 7.0, 9.0)):
        (folder / f"{number}.json").write_text(decision(rules, difference).to_json())
    result = invoke("diff", old, new, "--alone", "--pairs", folder)
    assert result.exit_code == 1
    assert result.output == (
        "changed  threshold exposure_dn (MEA901), value: 6 dn -> 8 dn\n"
        "e.g. MEA901, given brightness mean_difference_dn 6.0: note the major finding exposure-differs -> stays quiet\n"
        "\n"
        "1 of 3 recorded decisions change\n"
        f"{folder}/1.json (differs by 7)\n"
        "  correction.radiometry: correction.match_histograms (COR901) -> none (default)\n"
        "  finding gone: exposure-differs (major)\n"
    )
    data = json.loads(invoke("diff", old, new, "--alone", "--pairs", folder, "--format", "json").output)
    assert [bool(item["changes"]) for item in data["decisions"]] == [False, True, False]
    assert data["rules"][0]["what"] == "threshold exposure_dn (MEA901)"
    same = invoke("diff", old, old, "--alone", "--pairs", folder)
    assert (same.exit_code, same.output) == (0, "no difference in meaning\n\n0 of 3 recorded decisions change\n")


def test_a_layer_is_compared_with_the_shipped_rules_and_a_folder_without_records_is_refused(tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text("version: 1\ndisable: [COR016]\n")
    result = invoke("diff", "shipped", rig)
    assert result.exit_code == 0
    assert result.output.startswith("removed  rule COR016: In correction, when ")
    assert invoke("diff", "shipped", rig, "--pairs", tmp_path).exit_code == 2
    assert invoke("diff", "shipped", tmp_path / "none.yaml").exit_code == 2


@pytest.mark.parametrize("name", ENGINES)
def test_the_recorded_facts_give_the_same_core_again(name):
    pair = shifted_pair(calibration=Calibration(200.0, 80.0, 60.0, 0.1, 160, 120))
    for made in (ExpertSystem(engine=name).decide(pair), ExpertSystem(profile="fast").reconstruct(pair).decision):
        again = redecided(made, rules_of(made), make_engine(name, WORDS))
        assert again.core() == made.core()
